"""The ways the plant's kernels are compiled.

They allocate nothing, so numba's reference counting is switched off; it would cost a third of a
tick. Kernels on the base model's path are inlined: each array costs seven arguments per call.
"""

from collections.abc import Callable
from typing import Any

from numba.extending import register_jitable

from hilserver.compiled import kernel

part: Callable[[Callable[..., Any]], Any] = kernel(_nrt=False)
"""A kernel called from outside, or one that belongs to terms."""

inlined: Callable[[Callable[..., Any]], Any] = kernel(_nrt=False, forceinline=True)
"""A kernel of the base model's path."""

plain: Callable[[Callable[..., Any]], Any] = register_jitable(error_model="numpy")
"""Ordinary Python that kernels can call, too."""
