"""The real robot's topics: what it measures becomes `measured.*`, beside the simulated robot.

Each topic is a source of its own, stale by itself: the wheels stay Good when the tag falls silent.
Of two topics that measure the same, the one that was heard first counts until it falls silent.
"""

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Any, Final

from hilserver.config.ros2 import REAL_ROBOT, Ros2Config, Ros2Measured
from hilserver.core.events import Event, EventKind
from hilserver.core.refusal import Refusal, check_value
from hilserver.core.staleness import Staleness, Transition
from hilserver.io.link_status import FaultBook, LinkState, PeerStatus
from hilserver.io.ros2.participant import Arrival, In, Participant
from hilserver.io.ros2.wire import WireTypes
from hilserver.io.source import WrongValue
from hilserver.io.world import Part, World
from hilserver.ros.measured import MEASURED_TYPES, Conventions, MeasuredType, stamp_ns
from hilserver.ros.qos import SENSOR_DATA
from hilserver.ros.types import Types
from hilserver.signals import MEASURED

OLDEST_NS: Final = 1_000_000_000
AHEAD_NS: Final = 100_000_000
"""Stamps that are further behind or ahead of our clock are those of another clock ..."""
LATE_IN_A_ROW: Final = 20
"""... if there are more of them in a row than come late after a standstill of ours."""
SAID_ALL_NS: Final = 5_000_000_000
"""After its first message a robot has said by then what it has to say."""
MOST_REMARKS: Final = 50
MOST_WRITERS: Final = 50


class MeasuredFault(StrEnum):
    """Ways in which the real robot's messages can be wrong."""

    BAD_MESSAGE = "bad_message"
    STAMP = "stamp"
    TWO_ROBOTS = "two_robots"


@dataclass(slots=True)
class _Topic:
    name: str
    measures: MeasuredType
    staleness: Staleness
    # by writer: its last message
    heard_ns: dict[int, int] = field(default_factory=dict)
    has_values: bool = False
    off_in_a_row: int = 0  # messages whose stamps are out of range

    @property
    def source(self) -> str:
        return f"ros2:{self.name}"


class RealRobot(Part):
    """Reads the real robot's topics, through the participant of the node."""

    section, label, is_early = "ros2", "ROS 2, real robot", True  # like the node
    status: PeerStatus  # always up to date

    def __init__(
        self, config: Ros2Config, measured: Ros2Measured, world: World, types: Types
    ) -> None:
        self._world, self._types = world, types
        self._limit_ns = round(measured.stale_after_ms * 1e6)
        self._how = Conventions.of(
            config.flavour,
            config.array_order,
            measured.frame.lstrip("/"),
            measured.base_frame.lstrip("/"),
            measured.joints,
            is_on_one_axle=not world.shape.wheelbase_m,
        )
        self._topics = [
            _Topic(
                measured.full_name(name),
                MEASURED_TYPES[kind],
                Staleness(self._limit_ns),
            )
            for name, kind in measured.topics.items()
        ]
        self._ins: list[tuple[_Topic, In]] = []
        self.status = PeerStatus(
            REAL_ROBOT, ", ".join(topic.name for topic in self._topics), mode="dds"
        )
        self._faults = FaultBook(
            self.status,
            world.events.publish,
            (*MeasuredFault, WrongValue.REFUSED_VALUE),
        )
        self._giving: dict[str, _Topic] = {}  # by signal, the topic that it comes from
        self._told: set[str] = set()
        self._first_ns: int | None = None
        self._has_told_missing = False

    @property
    def address(self) -> str:
        """Its topics."""
        return self.status.endpoint

    def join(self, participant: Participant, wire: WireTypes) -> None:
        """Open the readers."""
        for topic in self._topics:
            kind = topic.measures.type
            self._types.prepare(kind)
            made = participant.reader(
                f"rt{topic.name}", wire.make(kind), SENSOR_DATA, self._types.hash(kind)
            )
            self._ins.append((topic, made))

    async def start(self) -> None:
        """Let its signals wait for their first value."""
        for topic in self._topics:
            names = [MEASURED + signal for signal in topic.measures.signals]
            self._world.gate.expect(topic.source, names)
        self.status.state = LinkState.CONNECTING

    async def stop(self) -> None:
        """Forget the readers, which end with the node."""
        self._ins = []
        self.status.connected, self.status.state = False, LinkState.STOPPED

    @property
    def endpoints(self) -> list[tuple[str, In]]:
        """Its readers, by topic."""
        return [(topic.name, reader) for topic, reader in self._ins]

    def receivers(self) -> Iterator[tuple[In, Callable[[Arrival], None]]]:
        """Yield each reader with what takes its messages."""
        for topic, reader in self._ins:
            yield reader, partial(self._receive, topic)

    # --- what comes in ----------------------------------------------------------------------------

    def _receive(self, topic: _Topic, arrival: Arrival) -> None:
        now_ns = time.monotonic_ns()
        if not topic.measures.is_shared and self._is_disputed(
            topic, arrival.writer, now_ns
        ):
            sentence = (
                f"{topic.name}: two nodes publish it, so nothing of it is taken: give each robot a"
                " namespace of its own (ros2.measured.namespace), or end one of the nodes"
            )
            self._faults.report(MeasuredFault.TWO_ROBOTS, topic.name, sentence, now_ns)
            return
        try:
            message = self._types.decode(arrival.cdr, topic.measures.type)
            values = topic.measures.read(self._how, message)
        except ValueError as error:
            sentence = f"{topic.name}: {error}"
            self._faults.report(MeasuredFault.BAD_MESSAGE, topic.name, sentence, now_ns)
            return
        self._tell_remarks(topic)
        fitting = self._checked(topic, values, now_ns)
        if fitting:
            self._hand_over(
                topic, fitting, self._age_ns(topic, message, arrival, now_ns), now_ns
            )

    def _is_disputed(self, topic: _Topic, writer: int, now_ns: int) -> bool:
        """Whether another writer was heard lately: it may be another robot."""
        if len(topic.heard_ns) >= MOST_WRITERS:
            topic.heard_ns.clear()
        topic.heard_ns[writer] = now_ns
        return any(
            other != writer and now_ns - heard_ns < self._limit_ns
            for other, heard_ns in topic.heard_ns.items()
        )

    def _checked(
        self, topic: _Topic, values: dict[str, float], now_ns: int
    ) -> dict[str, float]:
        """Return the values as inputs; none, and a report, if one of them does not fit."""
        gate, table = self._world.gate, self._world.table
        inputs = {MEASURED + signal: value for signal, value in values.items()}
        for name, value in inputs.items():
            reason = check_value(table[name], value)
            if isinstance(reason, Refusal):
                why = gate.explain(topic.source, name, reason)
                sentence = (
                    f"{topic.name}: {name} = {value:g} was refused, and the rest: {why}"
                )
                self._faults.report(
                    WrongValue.REFUSED_VALUE, topic.name, sentence, now_ns
                )
                return {}
        return inputs

    def _age_ns(
        self, topic: _Topic, message: Any, arrival: Arrival, now_ns: int
    ) -> int:
        """Return how long ago it was measured: by its own stamp, else by that of its writer."""
        utc_ns = self._world.clock.utc_ns(now_ns)
        written_ago_ns = utc_ns - arrival.source_ns if arrival.source_ns > 0 else 0
        if arrival.source_ns > 0:
            self.status.one_way.observe(max(written_ago_ns, 0))

        stamped_ns = stamp_ns(message)
        ago_ns = utc_ns - stamped_ns if stamped_ns else written_ago_ns
        topic.off_in_a_row = 0 if _is_likely(ago_ns) else topic.off_in_a_row + 1
        if topic.off_in_a_row > LATE_IN_A_ROW:
            side = "behind" if ago_ns > 0 else "ahead of"
            sentence = (
                f"{topic.name}: its stamps are {abs(ago_ns) * 1e-9:.3g} s {side} this computer's"
                " clock, so the time of writing counts: synchronise the clocks"
            )
            self._faults.report(MeasuredFault.STAMP, topic.name, sentence, now_ns)
        for one_ns in (ago_ns, written_ago_ns):
            if _is_likely(one_ns):
                return max(one_ns, 0)
        return 0

    def _hand_over(
        self, topic: _Topic, inputs: dict[str, float], age_ns: int, now_ns: int
    ) -> None:
        mine = {
            n: v
            for n, v in inputs.items()
            if self._giving.setdefault(n, topic) is topic
        }
        self._first_ns = self._first_ns or now_ns
        topic.staleness.renew(now_ns)
        topic.has_values = True
        self.status.sequence_received += 1
        if not mine:
            return
        refused = self._world.gate.write(
            topic.source, mine, received_ns=now_ns, age_ns=age_ns, renews=False
        )
        taken = mine.keys() - refused.keys()
        self.status.input_received_ns.update(dict.fromkeys(taken, now_ns))

    def _tell_remarks(self, topic: _Topic) -> None:
        for remark in self._how.remarks:
            sentence = f"{topic.name} {remark}"
            if sentence not in self._told and len(self._told) < MOST_REMARKS:
                self._told.add(sentence)
                self._tell(EventKind.STATE, 300, sentence)
        self._how.remarks.clear()

    def _tell(self, kind: EventKind, severity: int, text: str) -> None:
        self._world.events.publish(
            Event(kind, severity, REAL_ROBOT, f"ROS 2, real robot: {text}")
        )

    # --- silence ----------------------------------------------------------------------------------

    def watch(self, now_ns: int) -> None:
        """Judge the silence of each topic; called by the node."""
        self._faults.expire(now_ns)
        heard = [topic for topic in self._topics if topic.has_values]
        for topic in heard:
            transition = topic.staleness.check(now_ns)
            if transition is Transition.LOST:
                self._lose(topic)
            elif transition is not None:
                self._tell(
                    EventKind.PEER_RESTORED, 200, f"{topic.name} delivers values"
                )
        self.status.stale = not heard or any(topic.staleness.stale for topic in heard)
        self.status.connected = any(not topic.staleness.stale for topic in heard)
        here = LinkState.CONNECTED if self.status.connected else LinkState.CONNECTING
        self.status.state = here

        is_time = self._first_ns is not None and now_ns - self._first_ns > SAID_ALL_NS
        if is_time and not self._has_told_missing:
            self._has_told_missing = True
            self._tell_missing()

    def _lose(self, topic: _Topic) -> None:
        text = f"{topic.name}: {topic.staleness.reason}; its last values stay, as Uncertain"
        self._tell(EventKind.PEER_LOST, 800, text)
        self._world.gate.mark_stale(topic.source)
        self._giving = {
            name: giver for name, giver in self._giving.items() if giver is not topic
        }

    def _tell_missing(self) -> None:
        """Say which signals nothing delivers, and by which topics they would come."""
        delivered = {name.removeprefix(MEASURED) for name in self._giving}
        missing = [
            topic
            for topic in self._topics
            if not topic.has_values and not delivered.issuperset(topic.measures.signals)
        ]
        if not missing:
            return
        signals = dict.fromkeys(
            f"{MEASURED}{signal.partition('.')[0]}.*"
            for topic in missing
            for signal in topic.measures.signals
            if signal not in delivered
        )
        names = ", ".join(topic.name for topic in missing)
        text = f"nothing has come by {names}, so {', '.join(signals)} have no value"
        self._tell(EventKind.STATE, 300, text)


def _is_likely(ago_ns: int) -> bool:
    return -AHEAD_NS <= ago_ns <= OLDEST_NS
