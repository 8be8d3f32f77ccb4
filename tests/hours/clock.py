"""One clock for a whole process: `time.monotonic`, UTC and the event loop, in nanoseconds.

`install` has to come before the product is imported, as default arguments keep the functions that
they find. Outside a simulation the clock stands aside: it gives the computer's own time.
"""

import ctypes
import datetime
import os
import random
import sys
import threading
import time
from collections.abc import Callable
from types import ModuleType
from typing import Any

START_NS = 1_000_000_000_000  # a computer that has run for a while
UTC_AT_START_NS = 1_790_000_000_000_000_000 - START_NS
READ_NS = 1000  # what a look at the clock takes: whoever waits by looking gets on

_real = {
    name: getattr(time, name) for name in ("monotonic_ns", "time_ns", "perf_counter_ns")
}
_real_urandom = os.urandom


class Clock:
    """Virtual time. `on_advance` is called with the new time whenever some has passed."""

    def __init__(self) -> None:
        self.now_ns = START_NS
        self.is_running = False
        self._thread = threading.get_ident()
        self.on_advance: Callable[[int], None] = lambda _now_ns: None
        self.loop: Any = None

    def advance_to(self, now_ns: int) -> None:
        """Let time pass; it never goes back."""
        if now_ns > self.now_ns:
            self.now_ns = now_ns
            self.on_advance(now_ns)

    def read(self) -> int:
        """Look at the clock as a program does; another thread takes no time."""
        if threading.get_ident() != self._thread:
            return self.now_ns
        self.now_ns += READ_NS
        return self.now_ns


CLOCK = Clock()
_chance = random.Random(0)


def seed(number: int) -> None:
    """Let everything that is random follow from `number`."""
    _chance.seed(f"bytes {number}")
    random.seed(number)


def _monotonic_ns() -> int:
    return CLOCK.read() if CLOCK.is_running else _real["monotonic_ns"]()


def _utc_ns() -> int:
    return CLOCK.read() + UTC_AT_START_NS if CLOCK.is_running else _real["time_ns"]()


def _urandom(size: int) -> bytes:
    return _chance.randbytes(size) if CLOCK.is_running else _real_urandom(size)


def install() -> None:
    """Replace the clocks and the randomness of this process."""
    assert "hilserver.core.inputs" not in sys.modules, (
        "the product already has the real clock"
    )
    time.monotonic_ns, time.perf_counter_ns, time.time_ns = (
        _monotonic_ns,
        _monotonic_ns,
        _utc_ns,
    )
    time.monotonic = time.perf_counter = lambda: _monotonic_ns() * 1e-9
    time.time = lambda: _utc_ns() * 1e-9
    os.urandom = random._urandom = _urandom
    _blind_compiled_code()


def _blind_compiled_code() -> None:
    """Let compiled code find in its scratch what it asks the kernel for: nothing writes there.

    What it measures of itself would decide which figures the daemon has to publish anew.
    """
    from llvmlite import binding  # noqa: PLC0415 - loads numba's libraries

    nothing = ctypes.cast(ctypes.CDLL(None).abs, ctypes.c_void_p).value
    for name in ("clock_gettime", "getrusage"):
        binding.add_symbol(name, nothing)


class _TypeOfDates(type):
    def __instancecheck__(cls, value: object) -> bool:
        return isinstance(value, datetime.datetime)

    def __subclasscheck__(cls, kind: type) -> bool:
        return issubclass(kind, datetime.datetime)

    def __getattr__(cls, name: str) -> object:
        return getattr(datetime.datetime, name)

    def __call__(cls, *args: object, **named: object) -> datetime.datetime:
        return datetime.datetime(*args, **named)


class Dates(metaclass=_TypeOfDates):
    """In place of `datetime.datetime`, whose clock is compiled."""

    @staticmethod
    def now(zone: datetime.tzinfo | None = None) -> datetime.datetime:
        """Return the virtual time of day."""
        return datetime.datetime.fromtimestamp(_utc_ns() / 1e9, zone)


def install_dates(
    packages: tuple[str, ...] = ("hilserver", "asyncua", "tests"),
) -> None:
    """Let the modules of these packages that are loaded by now read the virtual time of day."""
    for name, module in tuple(sys.modules.items()):
        is_ours = name.partition(".")[0] in packages and isinstance(module, ModuleType)
        if is_ours and vars(module).get("datetime") is datetime.datetime:
            module.datetime = Dates
