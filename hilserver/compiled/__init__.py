"""Tools for compiled code: the `kernel` decorator with its cache, libc calls, atomics.

The lowest room in the list of layers.
"""

from typing import TYPE_CHECKING

from hilserver.lazily import lazily

if TYPE_CHECKING:
    from hilserver.compiled.cache import kernel, kernel_hash
else:
    __getattr__ = lazily(__name__, cache=("kernel", "kernel_hash"))

__all__ = ["kernel", "kernel_hash"]
