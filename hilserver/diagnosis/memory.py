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
ALLOCATION: Final = {
    _M_ARENA_MAX: 2,
    _M_TRIM_THRESHOLD: 1 << 28,
    _M_MMAP_THRESHOLD: 1 << 25,
}
"""With one pool per thread, freed large arrays stay in each pool: a tenth of all memory.

If they go back to the system, each page is cleared when the next replay requests it again.
"""


def reuse_memory() -> None:
    """Let glibc keep freed arrays in a few pools; with other libraries do nothing."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        for option, value in ALLOCATION.items():
            mallopt(option, value)


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Restrict a function's linear algebra to one thread; more would only wait."""

    @wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, "blas"):
            return function(*args, **kwargs)

    return inner
