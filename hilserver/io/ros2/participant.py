"""One DDS participant: domain, writers, readers, and a thread that waits for what comes in."""

import asyncio
import contextlib
import os
import socket
import stat
import threading
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final
from xml.sax.saxutils import quoteattr

import structlog
from cyclonedds.builtin import BuiltinDataReader
from cyclonedds.core import (
    DDSException,
    GuardCondition,
    InstanceState,
    ReadCondition,
    SampleState,
    ViewState,
    WaitSet,
)
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.internal import DDS, InvalidSample
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy
from cyclonedds.qos import Qos as DdsQos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

from hilserver.config.ros2 import LAST_DOMAIN, LOOPBACK, Ros2Config
from hilserver.errors import ConfigError, FailedError
from hilserver.io.ros2.wire import carried
from hilserver.ros.qos import Qos

MOST_AT_ONCE: Final = 32
PARTICIPANTS: Final = 32  # of one computer that find each other without multicast
ANNOUNCED_EVERY: Final = "1 s"
FAST_DDS: Final = "1.15"  # its vendor id
HANDLE: Final = 2**64 - 1
"""Bits of a handle; the library gives them with and without a sign."""
FIRST_PORT, PORTS_OF_A_DOMAIN = 7400, 250
_FATAL_AND_ERROR: Final = 3

_log = structlog.get_logger(__name__)


def domain_of(config: Ros2Config) -> int:
    """Return the DDS domain: the configured one, else ROS_DOMAIN_ID, else 0.

    ConfigError if ROS_DOMAIN_ID is not a valid domain.
    """
    if config.domain is not None:
        return config.domain
    text = os.environ.get("ROS_DOMAIN_ID", "").strip() or "0"
    if not text.isdecimal() or int(text) > LAST_DOMAIN:
        raise ConfigError(
            f"ROS_DOMAIN_ID is '{text}'; a domain is a number 0 .. {LAST_DOMAIN}"
        )
    return int(text)


def settings(interface: str, peers: tuple[str, ...]) -> str:
    """Return the configuration of Cyclone DDS, XML; loopback has no multicast."""
    local = interface in LOOPBACK
    place = "address" if interface[:1].isdigit() else "name"
    multicast = ' multicast="false"' if local else ""
    found = ("127.0.0.1", *peers) if local else peers
    listed = "".join(
        f"<Peer address={quoteattr(peer)}/>" for peer in dict.fromkeys(found)
    )
    return (
        '<CycloneDDS><Domain Id="any"><General>'
        f"<Interfaces><NetworkInterface {place}={quoteattr(interface)}{multicast}/></Interfaces>"
        f"<AllowMulticast>{'false' if local else 'default'}</AllowMulticast></General>"
        "<Discovery><ParticipantIndex>auto</ParticipantIndex>"
        f"<MaxAutoParticipantIndex>{PARTICIPANTS}</MaxAutoParticipantIndex>"
        # A node may start at any time, and by default announces itself by multicast only.
        f"<SPDPInterval>{ANNOUNCED_EVERY}</SPDPInterval>"
        "<InitialLocatorPruneDelay>inf</InitialLocatorPruneDelay>"
        f"<Peers>{listed}</Peers></Discovery>"
        # Fast DDS 3 describes its types in a way that Cyclone DDS 11 takes for invalid: nothing
        # would match. Types are told apart by their names, as with every older ROS 2.
        f"<Compatibility><IgnoreTypeInformation>{FAST_DDS}</IgnoreTypeInformation></Compatibility>"
        "</Domain></CycloneDDS>"
    )


def _keep_on_loopback(domain: int) -> None:
    """Let the sockets of a domain hear this computer only: DDS binds them to every interface."""
    first = FIRST_PORT + PORTS_OF_A_DOMAIN * domain
    for entry in Path("/proc/self/fd").iterdir():
        with contextlib.suppress(OSError):  # what another thread has closed meanwhile
            if stat.S_ISSOCK(os.fstat(int(entry.name)).st_mode):
                _keep_socket_on_loopback(int(entry.name), first)


def _keep_socket_on_loopback(number: int, first: int) -> None:
    with socket.socket(fileno=os.dup(number)) as found:
        is_udp = found.family == socket.AF_INET and found.type == socket.SOCK_DGRAM
        if (
            not is_udp
            or not first <= found.getsockname()[1] < first + PORTS_OF_A_DOMAIN
        ):
            return
        try:
            found.setsockopt(socket.SOL_SOCKET, socket.SO_BINDTODEVICE, b"lo\0")
        except PermissionError:
            _log.warning(
                "this kernel does not let ROS 2 stay on lo: close this UDP port to others",
                port=found.getsockname()[1],
            )


@dataclass(frozen=True, slots=True)
class Arrival:
    """A sample that came in: CDR, and when it was written [ns, UTC of the writer]."""

    cdr: bytes
    source_ns: int
    writer: int  # handle of the writer


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """What a writer and its readers have to agree on."""

    topic: str  # with the prefix of DDS, ``rt/cmd_vel``
    type: str  # as in DDS, ``geometry_msgs::msg::dds_::Twist_``
    type_hash: str
    qos: Qos


class Out:
    """A writer of one topic."""

    def __init__(self, writer: Any, data_type: Any, subject: TopicInfo) -> None:
        self._writer, self._type, self.subject = writer, data_type, subject

    @property
    def gid(self) -> bytes:
        """Its identity in the graph of ROS 2."""
        return bytes(self._writer.get_guid().bytes)

    @property
    def partners(self) -> list[int]:
        """Handles of the readers that match."""
        return [handle & HANDLE for handle in self._writer.get_matched_subscriptions()]

    def write(self, cdr: bytes) -> bool:
        """Write; False if a reliable reader is too far behind."""
        try:
            self._writer.write(carried(self._type, cdr))
        except DDSException as error:
            if error.code == DDSException.DDS_RETCODE_TIMEOUT:
                return False
            raise
        return True

    @property
    def matched(self) -> int:
        """Readers of other participants."""
        return int(self._writer.get_publication_matched_status().current_count)

    @property
    def incompatible(self) -> int:
        """Readers so far that request more than is offered."""
        return int(self._writer.get_offered_incompatible_qos_status().total_count)


class In:
    """A reader of one topic."""

    def __init__(self, reader: Any, subject: TopicInfo) -> None:
        self.reader, self.subject = reader, subject

    @property
    def gid(self) -> bytes:
        """Its identity in the graph of ROS 2."""
        return bytes(self.reader.get_guid().bytes)

    @property
    def partners(self) -> list[int]:
        """Handles of the writers that match."""
        return [handle & HANDLE for handle in self.reader.get_matched_publications()]

    def take(self) -> list[Arrival]:
        """Return what came in, oldest first."""
        return [
            Arrival(sample.cdr, info.source_timestamp, info.publication_handle & HANDLE)
            for sample in self.reader.take(MOST_AT_ONCE)
            if not isinstance(sample, InvalidSample) and (info := sample.sample_info)
        ]

    @property
    def matched(self) -> int:
        """Writers of other participants."""
        return int(self.reader.get_subscription_matched_status().current_count)

    @property
    def incompatible(self) -> int:
        """Writers so far that offer less than is requested."""
        return int(self.reader.get_requested_incompatible_qos_status().total_count)

    @property
    def lost(self) -> int:
        """Samples so far that never arrived."""
        return int(self.reader.get_sample_lost_status().total_count)


class Participant:
    """Joins the domain of a configuration.

    FailedError if there is no such interface, or the domain is in use in this process.
    """

    def __init__(self, config: Ros2Config) -> None:
        number = domain_of(config)
        try:
            self._domain = Domain(number, settings(config.interface, config.peers))
            # Otherwise every malformed packet writes a line to standard error and fills the disk.
            DDS._dll_handle.dds_set_log_mask(_FATAL_AND_ERROR)
            if config.interface in LOOPBACK:
                _keep_on_loopback(number)
            enclave = DdsQos(Policy.Userdata(b"enclave=/;"))
            self._participant = DomainParticipant(number, enclave)
        except DDSException as error:
            raise FailedError(
                f"ros2: no DDS domain {number} on interface '{config.interface}' ({error.msg});"
                f" check its name, and that no other program uses its ports"
            ) from None
        self.number, self.gid = number, bytes(self._participant.get_guid().bytes)
        self._waiting: _Waiting | None = None
        self._readers: list[Any] = []

    def writer(self, topic: str, data_type: Any, qos: Qos, type_hash: str) -> Out:
        """Return a writer."""
        subject = _subject(topic, data_type, qos, type_hash)
        made = DataWriter(
            self._participant,
            Topic(self._participant, topic, data_type),
            _policies(subject),
        )
        return Out(made, data_type, subject)

    def reader(self, topic: str, data_type: Any, qos: Qos, type_hash: str) -> In:
        """Return a reader."""
        subject = _subject(topic, data_type, qos, type_hash)
        made = DataReader(
            self._participant,
            Topic(self._participant, topic, data_type),
            _policies(subject),
        )
        self._readers.append(made)
        return In(made, subject)

    def discovered(self, what: Any) -> Any:
        """Return a reader of what discovery reports, one of the topics of `cyclonedds.builtin`."""
        return BuiltinDataReader(self._participant, what)

    def listen(self, on_data: Callable[[], None]) -> None:
        """Call `on_data` in the running event loop whenever a reader has data."""
        self._waiting = _Waiting(self._participant, self._readers, on_data)

    async def close(self) -> None:
        """Leave the domain."""
        if self._waiting is not None:
            await asyncio.to_thread(self._waiting.end)
        self._waiting = None
        self._readers.clear()


class _Waiting:
    """A thread that sleeps until a reader has data, and continues once the data is taken.

    Listeners would run Python in the receiving threads of DDS, which may then deadlock.
    """

    def __init__(
        self, participant: Any, readers: list[Any], on_data: Callable[[], None]
    ) -> None:
        self._on_data = on_data
        self._loop = asyncio.get_running_loop()
        self._ended = False
        self._taken = threading.Event()
        self._end = GuardCondition(participant)
        mask = SampleState.Any | ViewState.Any | InstanceState.Any
        self._conditions = [ReadCondition(reader, mask) for reader in readers]
        self._set = WaitSet(participant)
        for condition in (*self._conditions, self._end):
            self._set.attach(condition)
        self._thread = threading.Thread(target=self._run, name="ros2", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended:
            if self._set.wait(duration(seconds=1)) == 0 or self._ended:
                continue
            self._taken.clear()
            try:
                self._loop.call_soon_threadsafe(self._hand_over)
            except RuntimeError:  # the loop has ended
                return
            self._taken.wait()

    def _hand_over(self) -> None:
        try:
            self._on_data()
        finally:
            self._taken.set()

    def end(self) -> None:
        """End the thread."""
        self._ended = True
        self._taken.set()
        self._end.set(triggered=True)
        self._thread.join(5.0)


def _subject(topic: str, data_type: Any, qos: Qos, type_hash: str) -> TopicInfo:
    return TopicInfo(
        topic, data_type.__idl_typename__.replace(".", "::"), type_hash, qos
    )


def _policies(subject: TopicInfo) -> DdsQos:
    qos = subject.qos
    # our event loop does not wait
    reliable = Policy.Reliability.Reliable(duration(seconds=0))
    return DdsQos(
        reliable if qos.reliable else Policy.Reliability.BestEffort,
        Policy.Durability.TransientLocal if qos.latched else Policy.Durability.Volatile,
        Policy.History.KeepLast(qos.depth),
        Policy.Userdata(f"typehash={subject.type_hash};".encode()),
        Policy.DataRepresentation(use_cdrv0_representation=True),
    )
