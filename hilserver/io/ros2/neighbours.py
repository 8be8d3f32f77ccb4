"""Who else is in the domain, by DDS discovery: participants, endpoints, and what separates us.

A participant is alive while it renews its lease, whether or not it sends messages.
"""

import re
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any, Final, NamedTuple

from cyclonedds.builtin import (
    BuiltinTopicDcpsParticipant,
    BuiltinTopicDcpsPublication,
    BuiltinTopicDcpsSubscription,
)
from cyclonedds.core import InstanceState
from cyclonedds.qos import Policy

from hilserver.io.ros2.participant import (
    FIRST_PORT,
    HANDLE,
    PARTICIPANTS,
    PORTS_OF_A_DOMAIN,
    In,
    Out,
    Participant,
    TopicInfo,
)

WRITTEN_BY_MANY: Final = ("/tf", "/tf_static")
"""Topics of which every node of a robot writes its part."""
MOST_ENDPOINTS_AT_ONCE: Final = 200
MOST_KNOWN: Final = 5000
SETTLED_NS: Final = 3_000_000_000
"""Time within which what belongs together has found each other."""
_FIRST_UNICAST: Final = 10
LAST_PORT: Final = 65535
_HASH: Final = b"typehash="
_ADDRESS: Final = re.compile(r"udp/([0-9.]{7,15}):([0-9]{1,5})")
_LAST_CERTAIN: Final = 100
"""Ports of later domains are also given to any program that asks for a free one."""


class Apart(StrEnum):
    """Why an endpoint of the right name does not fit ours."""

    OTHER_TYPE = "other_type"
    TYPE_REFUSED = "type_refused"


class RemoteEndpoint(NamedTuple):
    """A writer or reader of another participant."""

    topic: str
    type: str  # as in DDS, ``geometry_msgs::msg::dds_::Twist_``
    type_hash: str  # empty if it announces none
    is_reliable: bool
    is_latched: bool
    participant: bytes
    gid: bytes
    since_ns: int


@dataclass(slots=True)
class Neighbour:
    """Another participant."""

    label: str  # for people
    # where its readers listen, by the usual ports
    addresses: tuple[tuple[str, int], ...]
    lease_s: float  # it counts as alive for so long after its last sign of life
    since_ns: int
    is_reported: bool = False  # a line of the log says that nothing of it fits


@dataclass(slots=True)
class Neighbours:
    """Keeps up with discovery; `look` takes what is new, and never waits."""

    participant: Participant
    now_ns: Callable[[], int] = time.monotonic_ns
    known: dict[bytes, Neighbour] = field(default_factory=dict)
    writers: dict[int, RemoteEndpoint] = field(default_factory=dict)
    readers: dict[int, RemoteEndpoint] = field(default_factory=dict)
    _discovered: list[Any] = field(default_factory=list)

    def __post_init__(self) -> None:
        topics = (
            BuiltinTopicDcpsParticipant,
            BuiltinTopicDcpsPublication,
            BuiltinTopicDcpsSubscription,
        )
        self._discovered = [self.participant.discovered(topic) for topic in topics]

    def look(self) -> None:
        """Take what discovery has reported since the last time."""
        people, writers, readers = self._discovered
        for sample in people.take(MOST_ENDPOINTS_AT_ONCE):
            self._meet(sample)
        for found, reader in ((self.writers, writers), (self.readers, readers)):
            for sample in reader.take(MOST_ENDPOINTS_AT_ONCE):
                self._note(found, sample)

    def _meet(self, sample: Any) -> None:
        gid = bytes(sample.key.bytes)
        if sample.sample_info.instance_state != InstanceState.Alive:
            self.known.pop(gid, None)
        elif (
            gid != self.participant.gid
            and gid not in self.known
            and len(self.known) < MOST_KNOWN
        ):
            self.known[gid] = _neighbour(sample.qos, self.now_ns())

    def _note(self, found: dict[int, RemoteEndpoint], sample: Any) -> None:
        handle = sample.sample_info.instance_handle & HANDLE
        if sample.sample_info.instance_state != InstanceState.Alive:
            found.pop(handle, None)
            return
        owner = bytes(sample.participant_key.bytes)
        if owner == self.participant.gid or len(found) >= MOST_KNOWN:
            return
        reliability, durability = (
            Policy.Reliability.Reliable,
            Policy.Durability.Volatile,
        )
        found[handle] = RemoteEndpoint(
            sample.topic_name,
            sample.type_name,
            _type_hash(sample.qos),
            isinstance(sample.qos[Policy.Reliability], reliability),
            sample.qos[Policy.Durability] != durability,
            owner,
            bytes(sample.key.bytes),
            self.now_ns(),
        )

    def participant_of(self, writer: int) -> Neighbour | None:
        """Return who has a writer; None if that writer or its participant is gone."""
        found = self.writers.get(writer)
        return self.known.get(found.participant) if found else None

    def replies_to(self, topic: str, participant: bytes) -> list[bytes]:
        """Return the readers of a topic of replies that a participant has."""
        return [
            reader.gid
            for reader in self.readers.values()
            if reader.topic == topic and reader.participant == participant
        ]

    def label(self, participant: bytes) -> str:
        """Return a participant for people."""
        found = self.known.get(participant)
        return found.label if found else "a participant that has left"

    def apart(self, ours: Sequence[In | Out]) -> Iterator[tuple[Apart, str, str]]:
        """Yield why an endpoint that should fit does not: kind, topic, sentence."""
        for endpoint in ours:
            if isinstance(endpoint, In):
                others, verb = self.writers, "writes"
            else:
                others, verb = self.readers, "reads"
            subject, partners = endpoint.subject, endpoint.partners
            same = [one.subject for one in ours if one.subject.topic == subject.topic]
            types = list(dict.fromkeys(one.type for one in same))
            for handle, other in others.items():
                if other.topic != subject.topic:
                    continue
                who = f"{self.label(other.participant)} {verb} {plain(other.topic)}"
                if other.type not in types:
                    if subject.type == types[0]:  # each is named once
                        text = (
                            f"{who} as {other.type}, which is {' or '.join(types)} here"
                        )
                        yield Apart.OTHER_TYPE, subject.topic, text
                elif other.type != subject.type:
                    continue  # fits another one of ours
                elif _has_other_fields(other, subject):
                    text = f"{who} as {subject.type} with other fields than here"
                    yield Apart.OTHER_TYPE, subject.topic, f"{text} ({other.type_hash})"
                elif handle not in partners and self._should_fit(endpoint, other):
                    text = (
                        f"{who}, was discovered, but its type information was refused"
                    )
                    yield Apart.TYPE_REFUSED, subject.topic, text

    def incompatible(self, ours: Sequence[In | Out]) -> Iterator[tuple[str, str]]:
        """Yield whose quality of service keeps messages of a topic back: topic, sentence.

        It lasts until one of the two endpoints is gone, as no endpoint changes these policies.
        """
        for endpoint in ours:
            reads = isinstance(endpoint, In)
            subject = endpoint.subject
            others = self.writers if reads else self.readers
            for other in others.values():
                if (other.topic, other.type) != (subject.topic, subject.type):
                    continue
                missing = _not_offered(endpoint, other)
                if not missing:
                    continue
                topic, who = plain(subject.topic), self.label(other.participant)
                asks, offers = ("the robot", who) if reads else (who, "the robot")
                more, less = _WORDS[missing[0]]
                remedy = f"write {topic} {more}" if reads else f"read {topic} {less}"
                yield (
                    f"{topic} {missing[0]}",
                    f"no data flows on {topic}: {asks} asks for {more}, {offers} offers {less};"
                    f" let {who} {remedy}",
                )

    def has_our_fields(self, writer: int, subject: TopicInfo) -> bool:
        """Whether a writer's messages are what we take them for; `apart` tells if not.

        DDS compares the names of types only.
        """
        if writer not in self.writers:
            self.look()  # a message may come before the last news of its writer
        found = self.writers.get(writer)
        return found is None or not _has_other_fields(found, subject)

    def clashes(self, ours: Iterable[Out]) -> Iterator[tuple[str, str]]:
        """Yield who also writes a topic that only the robot should write: whom, sentence."""
        for endpoint in ours:
            topic = endpoint.subject.topic
            if plain(topic) in WRITTEN_BY_MANY:
                continue
            for other in self.writers.values():
                if other.topic == topic:
                    who = self.label(other.participant)
                    sentence = (
                        f"{who} publishes {plain(topic)} as well, as the simulated robot does:"
                        " give one of them a namespace of its own (ros2.namespace)"
                    )
                    yield f"{topic} {other.participant.hex()}", sentence

    def _should_fit(self, ours: In | Out, other: RemoteEndpoint) -> bool:
        """Whether they have had time to match, and offer what the other side requests."""
        is_settled = self.now_ns() - other.since_ns > SETTLED_NS
        return is_settled and not _not_offered(ours, other)

    def strangers(self, ours: Iterable[In | Out]) -> Iterator[Neighbour]:
        """Yield those of which nothing matches, once they have had time for it."""
        matched = {handle for endpoint in ours for handle in endpoint.partners}
        found = {**self.writers, **self.readers}
        friends = {found[handle].participant for handle in matched & found.keys()}
        for gid, neighbour in self.known.items():
            is_settled = self.now_ns() - neighbour.since_ns > SETTLED_NS
            if gid not in friends and is_settled:
                yield neighbour


def topics_of(ours: Iterable[In | Out]) -> str:
    """Return names of topics for people."""
    return ", ".join(plain(endpoint.subject.topic) for endpoint in ours)


def other_domains(ours: int, udp: Path = Path("/proc/net/udp")) -> list[int]:
    """Return the domains of other programs on this computer, by the ports that they listen on."""
    found = set()
    for line in udp.read_text(encoding="ascii").splitlines()[1:]:
        port = int(line.split()[1].rpartition(":")[2], 16) - FIRST_PORT
        domain, place = divmod(port, PORTS_OF_A_DOMAIN)
        number = place - _FIRST_UNICAST
        is_discovery = 0 <= number < 2 * PARTICIPANTS and number % 2 == 0
        if is_discovery and 0 <= domain <= _LAST_CERTAIN:
            found.add(domain)
    return sorted(found - {ours})


def plain(topic: str) -> str:
    """Return the name of a topic in DDS for people."""
    return topic[2:] if topic[:3] in ("rt/", "rq/", "rr/") else topic


_WORDS: Final = {
    "reliability": ("RELIABLE", "BEST_EFFORT"),
    "durability": ("TRANSIENT_LOCAL", "VOLATILE"),
}


def _not_offered(ours: In | Out, other: RemoteEndpoint) -> list[str]:
    """Return the policies of which the reader of two endpoints requests more than is offered."""
    qos = ours.subject.qos
    mine = qos.reliable, qos.latched
    theirs = other.is_reliable, other.is_latched
    offered, requested = (theirs, mine) if isinstance(ours, In) else (mine, theirs)
    return [
        policy
        for policy, has, asks in zip(_WORDS, offered, requested, strict=True)
        if asks and not has
    ]


def _has_other_fields(other: RemoteEndpoint, subject: TopicInfo) -> bool:
    return bool(other.type_hash) and other.type_hash != subject.type_hash


def _type_hash(qos: Any) -> str:
    data = qos[Policy.Userdata]
    for part in (data.data if data is not None else b"").split(b";"):
        if part.startswith(_HASH):
            return part.removeprefix(_HASH).decode("ascii", "replace")[:80]
    return ""


def _neighbour(qos: Any, now_ns: int) -> Neighbour:
    said = {one.key: one.value for one in qos if isinstance(one, Policy.Property)}
    number = said.get("fastdds.physical_data.process") or said.get("__Pid")
    label = f"a node of process {number[:20]}" if number else "a node"
    found = _ADDRESS.findall(said.get("__NetworkAddresses", "")[:1000])
    # Discovery comes in at an even place of the domain's ports, data at the next one.
    addresses = tuple(
        (host, int(port) + 1) for host, port in found if int(port) < LAST_PORT
    )
    liveliness = qos[Policy.Liveliness]
    lease_s = liveliness.lease_duration * 1e-9 if liveliness is not None else 0.0
    return Neighbour(label, addresses, lease_s, now_ns)
