"""Tools for compiled code: the `kernel` decorator with its cache, libc calls, atomics.

The lowest room of the house.
"""

from hilserver.compiled.cache import cache_dir, kernel, kernel_hash

__all__ = ["cache_dir", "kernel", "kernel_hash"]
