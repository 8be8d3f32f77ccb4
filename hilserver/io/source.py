"""Input side of a link: groups of values to the gate, what is wrong with them, silence."""

from collections.abc import Callable, Collection, Iterable, Mapping
from enum import StrEnum
from typing import Final, NamedTuple

from hilserver.config.section import Driver
from hilserver.core.events import Event, EventKind
from hilserver.core.inputs import InputGate
from hilserver.core.refusal import Refusal
from hilserver.core.staleness import Staleness, Transition
from hilserver.io.arrival import Arrivals
from hilserver.io.link_status import FaultBook, PeerStatus

OFFERED_AGAIN: Final = frozenset(
    {
        Refusal.NOT_IN_CONTROL,
        Refusal.QUEUE_FULL,
        Refusal.OUTDATED,
        Refusal.NOT_AT_REST,
        Refusal.NOT_STARTED,
        Refusal.INCOMPLETE,
    }
)
"""Reasons that do not lie in the value: the next group may be accepted unchanged."""


class WrongValue(StrEnum):
    """The fault that every link can have."""

    REFUSED_VALUE = "refused_value"


class Outcome(NamedTuple):
    """Result of a group: all refusals, and those that do not depend on who has control."""

    refused: Mapping[str, Refusal]
    wrong: Mapping[str, Refusal]


class Source:
    """Hands over the values of one link; reports once when something is wrong and when it ends.

    `is_exact`: the time given with a write is known to be that of its arrival. `kinds`: faults that
    the link can have besides.
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
        kinds: Iterable[StrEnum] = (),
    ) -> None:
        self.name = driver.source
        self.status = status
        self.faults = FaultBook(status, publish, (*kinds, *WrongValue))
        self.staleness = Staleness(round(driver.limit_ms * 1e6), commanding)
        self._label = label
        self._gate = gate
        self._publish = publish
        self._on_stale = driver.on_stale
        self._fresh = fresh
        self._arrivals = Arrivals(self.staleness.limit_ns)
        self._is_exact = is_exact
        # if the first command lapsed at once, nothing could start
        self._has_written = False

    def came_ns(self, now_ns: int) -> int:
        """Return when the data that is read now came in."""
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
        by_hand: bool = False,
        broken: Collection[str] = (),
    ) -> Outcome:
        """Hand one group to the gate; report what is wrong with it, as values of `of`."""
        came_ns = self.came_ns(now_ns)
        self._has_written = True
        refused = self._gate.write(
            self.name,
            values,
            received_ns=now_ns,
            commanded_ns=came_ns,
            age_ns=age_ns,
            news=news,
            renews=renews,
            by_hand=by_hand,
            broken=broken,
        )
        wrong = {name: why for name, why in refused.items() if why not in OFFERED_AGAIN}
        for name, why in wrong.items():
            sentence = f"{of}{name} = {values[name]!r:.60} was refused: {why}"
            self.faults.report(WrongValue.REFUSED_VALUE, name, sentence, now_ns)
        return Outcome(refused, wrong)

    def expect(self, names: Iterable[str]) -> None:
        """Mark signals as waiting for their first value."""
        self._gate.expect(self.name, names)

    def watch(self, now_ns: int) -> Transition | None:
        """Judge its silence and return what changed; called every `WATCH_S` of real time."""
        self._arrivals.look(now_ns)
        self.faults.expire(now_ns)
        transition = self.staleness.check(now_ns)
        self.status.stale = self.staleness.stale
        if transition is Transition.LOST:
            text = (
                f"{self._label}: {self.staleness.reason}; on_stale is {self._on_stale}"
            )
            self._tell(EventKind.PEER_LOST, 800, text, now_ns)
            self._gate.mark_stale(self.name)
        elif transition is not None:
            self._tell(EventKind.PEER_RESTORED, 200, self._fresh(), now_ns)
        return transition

    def _tell(self, kind: EventKind, severity: int, text: str, now_ns: int) -> None:
        self._publish(Event(kind, severity, self.status.name, text, now_ns))
