"""Tools for compiled code: the `kernel` decorator with its cache, libc calls, atomics.

The lowest room in the list of layers.
"""

from typing import TYPE_CHECKING

from hilserver.lazily import lazily

if TYPE_CHECKING:
    from hilserver.compiled.cache import inlined, kernel, kernel_hash, part, plain
else:
    __getattr__ = lazily(
        __name__, cache=("inlined", "kernel", "kernel_hash", "part", "plain")
    )

__all__ = ["inlined", "kernel", "kernel_hash", "part", "plain"]
