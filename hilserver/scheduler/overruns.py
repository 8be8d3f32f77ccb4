"""Overruns on the event loop: taken from the ring, explained, and passed to callbacks."""

import asyncio
import contextlib
import signal
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

from hilserver.period import Period
from hilserver.scheduler.causes import CauseFinder, Look, OverrunCause
from hilserver.scheduler.exchange import HEARTBEAT, NEXT_TICK
from hilserver.scheduler.faults import fault_of
from hilserver.scheduler.law import (
    KIND_NAMES,
    LATE_WAKE,
    LONG_RUN,
    NO_OVERRUN,
    OK,
    STOP,
)
from hilserver.scheduler.machine import Machine

LOOK_PERIOD_S = 0.1
STALLED_NS = 1_000_000_000
"""A loop that is silent for this long is reported at once: its own record may never come."""
STALLED = "stalled"  # consequence of a tick that has not ended
_SETTLE_NS = 20_000_000
"""A record is explained this long after its tick or later: a SIGCONT needs time to arrive."""


@dataclass(frozen=True, slots=True)
class OverrunReport:
    """One overrun, explained."""

    # the slice that is blamed: the first of the tick for a late wake, otherwise the longest
    slice: str
    # ``late_wake``, ``long_run`` or ``fault`` (a slice reported a fault in time)
    kind: str
    tick: int
    # of the tick (compiled slices) or of the slice (communication)
    latency_ns: int
    execution_ns: int
    missed: int  # planned starts that were given up
    cause: OverrunCause  # as far as the system shows
    # "" or what followed: ``single_overrun_limit``, ``consecutive_overrun_limit``, ``stopped``,
    # ``fault 3`` (the slice's own number), ``stalled``: it has not returned for a second
    consequence: str = ""
    part: str = ""  # "" or what took the time within the slice

    def __str__(self) -> str:
        """One line for a log."""
        duration = "started" if self.kind == KIND_NAMES[LATE_WAKE] else "ran"
        span_ns = self.latency_ns if duration == "started" else self.execution_ns
        late = " late" if duration == "started" else ""
        text = (
            f"{self.slice} {duration} {span_ns / 1e6:.3f} ms{late} in tick {self.tick}"
        )
        text += f": {self.cause}" + (f", {self.part}" if self.part else "")
        if self.missed:
            text += f", {self.missed} ticks missed"
        return text + (f", {self.consequence}" if self.consequence else "")


OverrunCallback = Callable[[OverrunReport], None]


class Overruns:
    """Takes records every 100 ms and calls the callbacks."""

    def __init__(self, machine: Machine, callbacks: list[OverrunCallback]) -> None:
        self._machine = machine
        self._callbacks = callbacks
        self._finder: CauseFinder | None = None
        self._period = Period(self._look)
        self._watches_signal = False
        self._heartbeat_ns = 0
        self._stalled = False

    def start(self, finder: CauseFinder) -> None:
        """Start taking records."""
        self._finder = finder
        self._loop = asyncio.get_running_loop()
        self._watch_sigcont(finder)
        self._period.start(LOOK_PERIOD_S, LOOK_PERIOD_S)

    def stop(self) -> None:
        """Report what is left and end; may be called twice."""
        if not self._period.is_running:
            return
        self._period.stop()
        self._report(time.monotonic_ns() + 1)
        if self._watches_signal:
            self._loop.remove_signal_handler(signal.SIGCONT)

    def communication(
        self,
        name: str,
        kind: int,
        tick: int,
        latency_ns: int,
        execution_ns: int,
        missed: int,
    ) -> None:
        """Report an overrun of a communication slice that has just ended."""
        if self._finder is None:
            return
        end_ns = time.monotonic_ns()
        late = kind == LATE_WAKE
        began_ns = end_ns - execution_ns - (latency_ns if late else 0)
        cause = self._finder.explain_communication(began_ns, end_ns, late=late)
        self._call(
            OverrunReport(
                name, KIND_NAMES[kind], tick, latency_ns, execution_ns, missed, cause
            )
        )

    def _look(self) -> None:
        self._report(time.monotonic_ns() - _SETTLE_NS)
        self._watch_heartbeat(time.monotonic_ns())

    def _watch_heartbeat(self, now_ns: int) -> None:
        """Report once a tick that does not end; two looks, as both sides may have been stopped."""
        before_ns, self._heartbeat_ns = (
            self._heartbeat_ns,
            self._machine.exchange.get(HEARTBEAT),
        )
        silent_ns = now_ns - self._heartbeat_ns
        stalled = before_ns == self._heartbeat_ns > 0 and silent_ns > STALLED_NS
        if stalled and not self._stalled:
            name, tick = (
                self._machine.statistics.names[0],
                self._machine.exchange.get(NEXT_TICK),
            )
            kind, cause = KIND_NAMES[LONG_RUN], OverrunCause.SLICE
            self._call(OverrunReport(name, kind, tick, 0, silent_ns, 0, cause, STALLED))
        self._stalled = stalled

    def _report(self, ended_before_ns: int) -> None:
        if self._finder is None:
            return
        names = self._machine.statistics.names
        look: Look | None = None
        while record := self._machine.exchange.take_record(ended_before_ns):
            # one look serves all records of this round
            look = look or self._finder.look()
            cause = (
                self._finder.explain(record, look)
                if record.kind
                else OverrunCause.SLICE
            )
            self._call(
                OverrunReport(
                    slice=names[record.slice_index],
                    kind="fault"
                    if record.kind == NO_OVERRUN
                    else KIND_NAMES[record.kind],
                    tick=record.tick,
                    latency_ns=record.latency_ns,
                    execution_ns=record.execution_ns,
                    missed=record.missed,
                    cause=cause,
                    consequence=_consequence(record.code),
                )
            )
        self._finder.look_around()

    def _call(self, report: OverrunReport) -> None:
        for callback in self._callbacks:
            try:
                callback(report)
            except Exception as error:  # noqa: BLE001 - the others still get it
                self._loop.call_exception_handler(
                    {"message": "an overrun callback failed", "exception": error}
                )

    def _watch_sigcont(self, finder: CauseFinder) -> None:
        # A program that embeds the daemon may handle SIGCONT itself; it keeps it.
        main = threading.current_thread() is threading.main_thread()
        if main and signal.getsignal(signal.SIGCONT) == signal.SIG_DFL:
            with contextlib.suppress(NotImplementedError, RuntimeError, ValueError):
                self._loop.add_signal_handler(signal.SIGCONT, finder.continued)
                self._watches_signal = True


def _consequence(code: int) -> str:
    if code == OK:
        return ""
    return "stopped" if code == STOP else fault_of(code).name
