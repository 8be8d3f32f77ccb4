"""The way in of a link: groups of values to the gate, what is wrong with them, silence."""

import asyncio
from collections.abc import Callable, Collection, Iterable, Mapping
from enum import StrEnum
from typing import Final, NamedTuple

from hilserver.config.section import Driver
from hilserver.core.events import Event, EventKind
from hilserver.core.inputs import InputGate, Refusal
from hilserver.core.staleness import Staleness, Transition
from hilserver.io.arrival import WATCH_S, Arrivals
from hilserver.io.link_status import FaultBook, PeerStatus

OFFERED_AGAIN: Final = frozenset({Refusal.NOT_IN_CONTROL, Refusal.QUEUE_FULL, Refusal.OUTDATED})
"""Reasons that are not the value's: the next group may be accepted as it is."""


class WrongValue(StrEnum):
    """The fault that every link can have."""

    REFUSED_VALUE = "refused_value"


class Outcome(NamedTuple):
    """What came of a group: all that was refused, and what is wrong whoever has control."""

    refused: Mapping[str, Refusal]
    wrong: Mapping[str, Refusal]


async def keep_watch(look: Callable[[], object]) -> None:
    """Look every `WATCH_S` of real time, whatever the speed of the simulated one."""
    while True:
        look()
        await asyncio.sleep(WATCH_S)


class Source:
    """Hands over what one link brings; says once, each time it begins and ends, what it lacks.

    `is_exact`: the time with which a write comes is known to be when it came in.
    """

    def __init__(
        self,
        driver: Driver,
        label: str,
        status: PeerStatus,
        gate: InputGate,
        publish: Callable[[Event], None],
        *,
        fresh: Callable[[], str],
        commanding: Collection[str] = (),
        is_exact: bool = False,
    ) -> None:
        self.name, self.status = driver.source, status
        self.faults = FaultBook(status, publish)
        self.staleness = Staleness(round(driver.limit_ms * 1e6), commanding)
        self._label, self._gate, self._publish = label, gate, publish
        self._on_stale, self._fresh = driver.on_stale, fresh
        self._arrivals, self._is_exact = Arrivals(self.staleness.limit_ns), is_exact
        self._has_written = False  # a first command that lapses at once would stop the start

    def came_ns(self, now_ns: int) -> int:
        """Return when what is read now came in."""
        came_ns = self._arrivals.came_ns(now_ns)
        return now_ns if self._is_exact or not self._has_written else came_ns

    def write(
        self,
        values: Mapping[str, object],
        now_ns: int,
        *,
        of: str = "",
        age_ns: int = 0,
        news: Collection[str] | None = None,
        renews: bool = True,
    ) -> Outcome:
        """Hand one group to the gate; report what is wrong with it, as values of `of`."""
        came_ns, self._has_written = self.came_ns(now_ns), True
        refused = self._gate.write(
            self.name,
            values,
            received_ns=now_ns,
            commanded_ns=came_ns,
            age_ns=age_ns,
            news=news,
            renews=renews,
        )
        wrong = {name: why for name, why in refused.items() if why not in OFFERED_AGAIN}
        for name, why in wrong.items():
            sentence = f"{of}{name} = {values[name]!r:.60} was refused: {why}"
            self.faults.report(WrongValue.REFUSED_VALUE, name, sentence, now_ns)
        return Outcome(refused, wrong)

    def expect(self, names: Iterable[str]) -> None:
        """Have signals wait for their first value."""
        self._gate.expect(self.name, names)

    def watch(self, now_ns: int) -> Transition | None:
        """Judge its silence; called every `WATCH_S`, see `keep_watch`. Return what changed."""
        self._arrivals.look(now_ns)
        self.faults.expire(now_ns)
        transition = self.staleness.check(now_ns)
        self.status.stale = self.staleness.stale
        if transition is Transition.LOST:
            text = f"{self._label}: {self.staleness.reason}; on_stale is {self._on_stale}"
            self._tell(EventKind.PEER_LOST, 800, text, now_ns)
            self._gate.mark_stale(self.name)
        elif transition is not None:
            self._tell(EventKind.PEER_RESTORED, 200, self._fresh(), now_ns)
        return transition

    def _tell(self, kind: EventKind, severity: int, text: str, now_ns: int) -> None:
        self._publish(Event(kind, severity, self.status.name, text, now_ns))
