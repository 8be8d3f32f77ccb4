"""The ways the plant's kernels are compiled.

They allocate nothing, so numba's reference counts are left out (a third of a tick otherwise). What
the base model runs through is inlined: an array costs seven arguments per call.
"""

from collections.abc import Callable
from typing import Any

from numba.extending import register_jitable

from hilserver.compiled import kernel

part: Callable[[Callable[..., Any]], Any] = kernel(_nrt=False)
"""A kernel that stands for itself or belongs to terms."""

inlined: Callable[[Callable[..., Any]], Any] = kernel(_nrt=False, forceinline=True)
"""A kernel of the base model's path."""

plain: Callable[[Callable[..., Any]], Any] = register_jitable(error_model="numpy")
"""Python as it stands that kernels can call, too."""
