"""The dead-man of page and teleop: a held command ends with the messages that renew it.

It lives in the daemon, so that it acts whatever has become of browser, network or process.
"""

import asyncio
from collections.abc import Callable
from typing import Protocol

from hilserver.core.events import Event, EventBus, EventKind
from hilserver.core.inputs import InputGate, kind_of

PAGE, TELEOP = "page", "opcua:teleop"


class Timer(Protocol):
    """What `loop.call_later` returns."""

    def cancel(self) -> None:
        """Do not call."""


class DeadMan:
    """Sets the set-points to zero when a source holds them and does not renew them in time.

    A source holds the set-points while one that it wrote last is not zero. Each of its writes
    counts anew, those of others do not; whoever else takes control and writes is not stopped.

    Parameters
    ----------
    limit_s : float
        Time without a write after which a held command ends.
    call_later : callable
        ``(delay_s, callback, source) -> Timer``; that of the running loop by default.
    """

    def __init__(
        self,
        gate: InputGate,
        events: EventBus,
        limit_s: float,
        call_later: Callable[[float, Callable[[str], None], str], Timer] | None = None,
    ) -> None:
        self._gate, self._events, self._limit_s = gate, events, limit_s
        self._call_later = call_later
        self._timers: dict[str, Timer] = {}
        gate.on_setpoints.append(self.renew)

    def renew(self, source: str) -> None:
        """Count anew: `source` has written set-points."""
        if kind_of(source) != PAGE and source != TELEOP:
            return
        timer = self._timers.pop(source, None)
        if timer is not None:
            timer.cancel()
        if self._gate.holds_setpoints(source):
            later = self._call_later or asyncio.get_running_loop().call_later
            self._timers[source] = later(self._limit_s, self._expire, source)

    def _expire(self, source: str) -> None:
        self._timers.pop(source, None)
        if not self._gate.holds_setpoints(source):
            return
        self._gate.stop()
        text = f"no fresh command for {self._limit_s * 1e3:g} ms: set-points zero"
        self._events.publish(Event(EventKind.STATE, 500, source, text))
