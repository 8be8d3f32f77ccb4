"""The back end for comparison: the event loop itself runs the tick, woken by a timerfd.

Event-loop timers never pace (uvloop's are whole milliseconds); a timer file descriptor is exact,
but the tick still waits for whatever the event loop is doing. `bench jitter` shows what that costs.
"""

import asyncio
import contextlib
import ctypes
import os
import threading
import time

from hilserver.scheduler.law import PLANNED, begin
from hilserver.scheduler.machine import Machine
from hilserver.scheduler.pacing import Ended, Rung, StopReason
from hilserver.scheduler.pacing_loop import LONGEST_SLEEP_NS
from hilserver.scheduler.realtime import AuditFinding, ProcessGrants, RealtimeSettings
from hilserver.scheduler.turn import ENDED, RAN, RING

_CLOCK_MONOTONIC = 1
_TFD_TIMER_ABSTIME = 1
_TURNS_PER_WAKE = 8  # most late ticks in a row before the event loop gets its turn


class _TimerSpec(ctypes.Structure):
    """struct itimerspec: interval (0: one shot) and value."""

    _fields_ = (
        ("interval_s", ctypes.c_long),
        ("interval_ns", ctypes.c_long),
        ("value_s", ctypes.c_long),
        ("value_ns", ctypes.c_long),
    )


class Timer:
    """A one-shot timerfd on CLOCK_MONOTONIC (``os.timerfd_create`` comes with Python 3.13)."""

    def __init__(self) -> None:
        self._libc = ctypes.CDLL(None, use_errno=True)
        self.fileno = self._libc.timerfd_create(
            _CLOCK_MONOTONIC, os.O_NONBLOCK | os.O_CLOEXEC
        )
        if self.fileno < 0:
            raise OSError(ctypes.get_errno(), "timerfd_create")
        self._spec = _TimerSpec()

    def set(self, deadline_ns: int) -> None:
        """Fire at the absolute time `deadline_ns`; at once if it has passed."""
        # 0 would disarm the timer
        self._spec.value_s, self._spec.value_ns = divmod(max(deadline_ns, 1), 10**9)
        spec = ctypes.byref(self._spec)
        if self._libc.timerfd_settime(self.fileno, _TFD_TIMER_ABSTIME, spec, None) != 0:
            raise OSError(ctypes.get_errno(), "timerfd_settime")

    def clear(self) -> None:
        """Read the expiration, so that the descriptor is no longer readable."""
        with contextlib.suppress(BlockingIOError):
            os.read(self.fileno, 8)

    def close(self) -> None:
        """Close the descriptor."""
        os.close(self.fileno)


class TimerfdPacing:
    """Paces the machine from the event loop; `thread_id` is the event loop's."""

    def __init__(
        self, machine: Machine, settings: RealtimeSettings, rung: Rung, ended: Ended
    ) -> None:
        self._machine = machine
        self._rung = rung
        self._ended = ended
        self._process_grants = ProcessGrants(settings)
        self._timer: Timer | None = None
        self.thread_id = 0

    async def start(self) -> list[AuditFinding]:
        """Arm the timer for the first tick."""
        self.thread_id = threading.get_native_id()
        self._loop = asyncio.get_running_loop()
        grants = self._process_grants.request()
        self._machine.prefault()
        begin(self._machine.law, time.monotonic_ns() + self._machine.base_period_ns)
        self._timer = Timer()
        self._loop.add_reader(self._timer.fileno, self._woken)
        self._arm()
        return grants

    async def stop(self) -> None:
        """Close the timer."""
        if self._close():
            self._ended(StopReason.STOPPED)
        self._process_grants.release()

    def wake(self) -> None:
        """Nothing to do: commands are read at every wake-up."""

    def _woken(self) -> None:
        if self._timer is not None:
            self._timer.clear()
        for _ in range(_TURNS_PER_WAKE):
            flags = self._machine.turn(virtual=False)
            if flags & RING:
                self._rung()
            if flags & ENDED and self._close():
                self._ended(StopReason.OVERRUN)
                return
            if not flags & RAN or self._machine.law[PLANNED] > time.monotonic_ns():
                break
        self._arm()

    def _arm(self) -> None:
        if self._timer is not None:
            latest_ns = time.monotonic_ns() + LONGEST_SLEEP_NS
            self._timer.set(min(int(self._machine.law[PLANNED]), latest_ns))

    def _close(self) -> bool:
        """Close the timer; False if it was closed already."""
        if self._timer is None:
            return False
        self._loop.remove_reader(self._timer.fileno)
        self._timer.close()
        self._timer = None
        return True
