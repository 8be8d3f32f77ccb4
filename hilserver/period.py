"""Periods on the event loop.

Timers of an event loop are not exact: uvloop counts whole milliseconds and fires up to one too
early, a busy loop fires late, and a handle that was already due can still fire after it was
replaced. Code that compares with its own clock may then find that nothing is due, and wait for a
call that never comes. Here the clock is read in one place.
"""

import asyncio
import math
import time
from collections.abc import Awaitable, Callable
from typing import Protocol

_EARLY_S = 0.001
"""A loop's timers are early by at most this; it is added to each wait, so that one is enough."""


class Handle(Protocol):
    """What `loop.call_later` returns."""

    def cancel(self) -> None:
        """Do not call."""


class Period:
    """Calls once per period, on a fixed grid.

    After a timer that fires too early it waits for the rest, a timer that fires twice calls once,
    and missed periods are not made up for.
    """

    def __init__(
        self,
        call: Callable[[], object],
        clock: Callable[[], float] = time.monotonic,
        call_later: Callable[[float, Callable[[], None]], Handle] | None = None,
    ) -> None:
        self._call = call
        self._clock = clock
        self._call_later = call_later
        self._handle: Handle | None = None
        self._period_s = self._due_s = 0.0

    @property
    def is_running(self) -> bool:
        """Whether there will be another call."""
        return self._handle is not None

    def start(self, period_s: float, first_s: float) -> None:
        """Call in `first_s`, then every `period_s`; replaces earlier plans."""
        self._period_s, self._due_s = period_s, self._clock() + first_s
        self._plan(first_s)

    def stop(self) -> None:
        """Stop calling."""
        if self._handle is not None:
            self._handle.cancel()
            self._handle = None

    def _plan(self, delay_s: float) -> None:
        self.stop()
        later = self._call_later or asyncio.get_running_loop().call_later
        self._handle = later(delay_s + _EARLY_S if delay_s > 0 else 0.0, self._fire)

    def _fire(self) -> None:
        if self._handle is None:
            return
        late_s = self._clock() - self._due_s
        if late_s < 0:
            self._plan(-late_s)
            return
        periods = math.floor(late_s / self._period_s) + 1
        self._due_s += periods * self._period_s
        self._plan(self._due_s - self._clock())
        self._call()


async def every(
    period_s: float,
    cycle: Callable[[], Awaitable[float | None]],
    skipped: Callable[[int], None] = lambda _count: None,
) -> None:
    """Run `cycle` on absolute deadlines, one at a time; deadlines missed meanwhile are skipped.

    A cycle may return the time [s] from its deadline to the next one. `skipped` is called with the
    number of skipped deadlines.
    """
    loop = asyncio.get_running_loop()
    deadline = loop.time()
    while True:
        sooner_s = await cycle()
        deadline += period_s if sooner_s is None else sooner_s
        late = int((loop.time() - deadline) / period_s)
        if late > 0:
            deadline += late * period_s
            skipped(late)
        await asyncio.sleep(max(0.0, deadline - loop.time()))
