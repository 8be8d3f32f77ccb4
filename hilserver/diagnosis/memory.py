"""Memory and threads of a diagnosis: those of the C library and of its linear algebra."""

import ctypes
from collections.abc import Callable
from functools import wraps
from typing import Final, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")

# of malloc.h of glibc
_M_TRIM_THRESHOLD: Final = -1
_M_MMAP_THRESHOLD: Final = -3
_M_ARENA_MAX: Final = -8
ALLOCATION: Final = {_M_ARENA_MAX: 2, _M_TRIM_THRESHOLD: 1 << 30, _M_MMAP_THRESHOLD: 1 << 25}
"""With a pool for every thread, large arrays that are gone stay in each: a tenth of all memory; ...

... and given back to the system, to be asked for again at the next replay, each page is cleared.
"""


def reuse_memory() -> None:
    """Let glibc keep what arrays leave, in few pools; with other libraries do nothing."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for option, value in ALLOCATION.items():
            mallopt(option, value)


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function's linear algebra keep to one thread; the others would only wait."""

    @wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, "blas"):
            return function(*args, **kwargs)

    return inner
