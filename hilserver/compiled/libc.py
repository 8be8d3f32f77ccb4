"""libc calls for kernels, by name, so that the compiled code can be cached on disk.

Times are int64 nanoseconds of CLOCK_MONOTONIC. The callers own the small arrays that libc writes
to; nothing is allocated on the paced path.
"""

from typing import Any

from numba.core.types import ExternalFunction, int32, int64, uint64, voidptr

from hilserver.compiled.cache import inlined

CLOCK_MONOTONIC = 1
TIMER_ABSTIME = 1
EINTR = 4

clock_gettime: Any = ExternalFunction("clock_gettime", int32(int32, voidptr))
clock_nanosleep: Any = ExternalFunction(
    "clock_nanosleep", int32(int32, int32, voidptr, voidptr)
)
libc_write: Any = ExternalFunction("write", int64(int32, voidptr, uint64))


@inlined
def monotonic_ns(timespec: Any) -> int:
    """Return CLOCK_MONOTONIC in ns; `timespec` is a scratch int64[2]."""
    clock_gettime(CLOCK_MONOTONIC, timespec.ctypes)
    return int(timespec[0] * 1_000_000_000 + timespec[1])


@inlined
def sleep_until(deadline_ns: int, timespec: Any) -> None:
    """Sleep until the absolute time `deadline_ns`; `timespec` is a scratch int64[2].

    A signal may end the sleep early: it is resumed, at most 1000 times.
    """
    timespec[0] = deadline_ns // 1_000_000_000
    timespec[1] = deadline_ns % 1_000_000_000
    for _ in range(1000):
        if clock_nanosleep(CLOCK_MONOTONIC, TIMER_ABSTIME, timespec.ctypes, 0) != EINTR:
            return


@inlined
def ring_doorbell(file_descriptor: int, one: Any) -> int:
    """Add 1 to an eventfd; `one` is an int64[1] holding 1. Return libc's result (8 or -1)."""
    return int(libc_write(file_descriptor, one.ctypes, 8))
