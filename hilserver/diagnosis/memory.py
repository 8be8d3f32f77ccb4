"""Memory and threads of a diagnosis: those of the C library and of its linear algebra."""

import ctypes
from collections.abc import Callable
from functools import wraps
from typing import Final, ParamSpec, TypeVar

from threadpoolctl import threadpool_limits

P = ParamSpec("P")
R = TypeVar("R")

_M_ARENA_MAX: Final = -8  # malloc.h of glibc
ARENAS: Final = 2
"""With a pool for every thread, large arrays that are gone stay in each: a tenth of all memory."""


def share_arenas() -> None:
    """Keep glibc from giving each thread a pool of its own; with other libraries do nothing."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is not None:
        mallopt(_M_ARENA_MAX, ARENAS)


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Let a function's linear algebra keep to one thread; the others would only wait."""

    @wraps(function)
    def inner(*args: P.args, **kwargs: P.kwargs) -> R:
        with threadpool_limits(1, "blas"):
            return function(*args, **kwargs)

    return inner
