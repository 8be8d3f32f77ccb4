"""Paces the plant by the virtual clock: whenever time passes, the ticks that were due have run.

It stands for the thread of the product, which does not stop when the event loop does.
"""

from collections.abc import Callable
from functools import cache
from typing import Any

from numba.core.dispatcher import Dispatcher
from numba.experimental import function_type

from hilserver.scheduler.law import PLANNED, begin
from hilserver.scheduler.loop import TIMESPEC
from hilserver.scheduler.pacing import StopReason
from hilserver.scheduler.pacing_loop import run_batch
from hilserver.scheduler.turn import ENDED, RING, STANDING
from tests.hours.clock import CLOCK
from tests.hours.loop import NS


def _once(look_up: Callable[[Any, Any], int]) -> Callable[[Any, Any], int]:
    """Look an address up once for each step, of which each has one signature."""
    found: dict[Any, int] = {}

    def address(step: Any, signature: Any) -> int:
        if step not in found:
            found[step] = look_up(step, signature)
        return found[step]

    return address


# Looked up anew in every batch, type and addresses of the step would take most of its time.
Dispatcher._numba_type_ = property(cache(Dispatcher._numba_type_.fget))
for name in ("_get_wrapper_address", "_get_jit_address"):
    setattr(function_type, name, _once(getattr(function_type, name)))


class ClockPacing:
    """A back end of the scheduler, made as `ThreadPacing` is."""

    thread_id = 0

    def __init__(self, machine: Any, _settings: Any, rung: Any, ended: Any) -> None:
        self._machine, self._rung, self._ended = machine, rung, ended
        self._is_rung = self._is_over = False
        self._planned_ns = 0

    async def start(self) -> list[Any]:
        self._machine.prefault()
        begin(self._machine.law, CLOCK.now_ns + self._machine.base_period_ns)
        CLOCK.on_advance = self._advance
        self._loop = CLOCK.loop
        return []

    async def stop(self) -> None:
        CLOCK.on_advance = lambda _now_ns: None
        self._end(StopReason.STOPPED)

    def wake(self) -> None:
        """Look at the control words now."""
        self._advance(CLOCK.now_ns)

    def _advance(self, now_ns: int) -> None:
        if now_ns < self._planned_ns:
            return
        law, machine = self._machine.law, self._machine
        machine.loop.scratch[TIMESPEC : TIMESPEC + 2] = divmod(now_ns, NS)
        while not self._is_over and (late_ns := now_ns - int(law[PLANNED])) >= 0:
            due = late_ns // machine.base_period_ns + 1
            flags = run_batch(machine.step, machine.loop, due)
            if flags & RING:
                self._ring()
            if flags & ENDED:
                self._end(StopReason.OVERRUN)
            if flags & STANDING and law[PLANNED] <= now_ns:
                law[PLANNED] = now_ns + machine.base_period_ns
        self._planned_ns = int(law[PLANNED])

    def _ring(self) -> None:
        if not self._is_rung:
            self._is_rung = True
            self._loop.arrive(CLOCK.now_ns, self._answer)

    def _answer(self) -> None:
        self._is_rung = False
        self._rung()

    def _end(self, reason: StopReason) -> None:
        if not self._is_over:
            self._is_over = True
            self._ended(reason)
