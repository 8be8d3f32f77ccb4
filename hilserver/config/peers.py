"""The `peers:` section: controllers whose values we read and to which we write.

A peer at ``opc.tcp://`` has nodes, one at ``s7://`` has places in data blocks. A node is named
``nsu=<namespace URI>;s=<name>`` (looked up again at every connection, because a server may
renumber its namespaces after a restart) or ``ns=<index>;s=<name>``.
"""

import base64
import re
import uuid
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, Field, model_validator

from hilserver.config import s7, s7_peer
from hilserver.config.peer_security import PeerSecurity
from hilserver.config.section import Driver, LinkSection
from hilserver.errors import no_signal
from hilserver.opcua.loopback import is_loopback
from hilserver.opcua.settings import check_endpoint
from hilserver.signals import SignalTable

_NODE = re.compile(
    r"^(?:nsu=(?P<uri>[^;]+)|ns=(?P<index>\d{1,5}));(?P<identifier>[sigb]=.+)$"
)
_BLOCK = re.compile(r"^DB\d", re.IGNORECASE)
S7 = "s7://"
_NAMESPACE_MAX = 2**16 - 1
_NUMBER_MAX = 2**32 - 1


def _wrong_identifier(identifier: str) -> str:
    """Return what is wrong with ``i=...`` and the like; empty if nothing is."""
    kind = identifier[0]
    value = identifier[2:]
    if kind == "i" and not (
        value.isascii()
        and value.isdecimal()
        and len(value) < 12
        and int(value) <= _NUMBER_MAX
    ):
        return f"i= needs a number up to {_NUMBER_MAX}"
    try:
        if kind == "g":
            uuid.UUID(value)
        if kind == "b":
            base64.b64decode(value, validate=True)
    except ValueError:
        return "g= needs a GUID" if kind == "g" else "b= needs base64"
    return ""


@dataclass(frozen=True, slots=True)
class NodeAddress:
    """A node id whose namespace may still be a URI."""

    # from ``nsu=``, with ``%3B`` and ``%25`` decoded; None if the index is given
    namespace_uri: str | None
    namespace_index: int | None  # from ``ns=``
    identifier: str  # the rest, ``s=name``, ``i=number``, ``g=guid`` or ``b=base64``

    @classmethod
    def parse(cls, text: str) -> "NodeAddress":
        """Parse `text`; ValueError with one sentence if it is not a node id."""
        match = _NODE.match(text)
        if match is None:
            raise ValueError(
                f"'{text}' is not a node id: write nsu=<namespace URI>;s=<name>"
                " or ns=<index>;s=<name>"
            )
        identifier = match["identifier"]
        wrong = _wrong_identifier(identifier)
        if int(match["index"] or 0) > _NAMESPACE_MAX:
            wrong = f"ns= needs a number up to {_NAMESPACE_MAX}"
        if wrong:
            raise ValueError(f"'{text}' is not a node id: {wrong}")
        uri = match["uri"]
        namespace_uri = uri.replace("%3B", ";").replace("%25", "%") if uri else None
        index = int(match["index"]) if match["index"] else None
        return cls(
            namespace_uri=namespace_uri,
            namespace_index=index,
            identifier=identifier,
        )


def _check_node(text: str) -> str:
    if _BLOCK.match(text):
        return s7.check_address(text)
    NodeAddress.parse(text)
    return text


def _check_peer(text: str) -> str:
    if text.startswith(S7):
        s7.Endpoint.parse(text)
        return text
    if urlsplit(check_endpoint(text)).port == 0:
        raise ValueError(f"'{text}' needs the port that the peer listens on")
    return text


NodeId = Annotated[str, AfterValidator(_check_node)]
Endpoint = Annotated[str, AfterValidator(_check_peer)]
Inputs = Annotated[tuple[str, ...], Field(min_length=1, max_length=100)]
Milliseconds = Annotated[float, Field(gt=0, le=3_600_000)]


class PeerConfig(LinkSection):
    """One peer."""

    name: Annotated[
        str,
        Field(
            pattern=r"^[A-Za-z0-9_-]{1,64}$",
            description="name in log, metrics and OPC UA",
        ),
    ]
    endpoint: Annotated[
        Endpoint,
        Field(
            description="opc.tcp://<host>:<port>/<path>, or s7://<host>/<rack>/<slot>"
        ),
    ]
    security: PeerSecurity = Field(default_factory=PeerSecurity)
    mode: Literal["auto", "subscribe", "poll"] = Field(
        "auto",
        description="subscribe, poll, or auto: poll when the peer grants too slow a rate",
    )
    publishing_ms: Milliseconds = Field(
        50, description="publishing interval to request"
    )
    sampling_ms: Annotated[float, Field(ge=0, le=3_600_000)] = Field(
        0, description="sampling interval to request; the granted one is shown"
    )
    poll_ms: Annotated[float, Field(ge=1, le=3_600_000)] = Field(
        10, description="period of the multi-read when polling"
    )
    stale_after_ms: Milliseconds = Field(
        500, description="inputs older than this are stale"
    )
    on_stale: Literal["hold", "zero", "ramp"] = Field(
        "ramp",
        description="what then happens to set-points: hold, zero, or ramp (safe state)",
    )
    read: Annotated[dict[NodeId, str | Inputs], Field(max_length=1000)] = Field(
        {},
        description="their node: our input signal, or a list of signals that get the same value",
    )
    heartbeat: s7_peer.Heartbeat = Field(default_factory=s7_peer.Heartbeat)
    sequence_node: NodeId | None = Field(
        None,
        description="their counter: shows that the controller runs, not only its server",
    )
    write: Annotated[dict[str, NodeId], Field(max_length=1000)] = Field(
        {}, description="our output signal: their node"
    )
    write_every_ms: Annotated[float, Field(ge=1, le=3_600_000)] = Field(
        20, description="period of the multi-write"
    )
    write_status: Literal["honest", "good"] = Field(
        "honest",
        description="status that is written: the real one, or always Good (stock clients raise on"
        " Uncertain); values that are Bad are then not written",
    )

    @model_validator(mode="after")
    def _consistent(self) -> "PeerConfig":
        if not self.read and not self.write:
            raise ValueError(
                f"peer '{self.name}' reads and writes nothing: add nodes to read or write"
            )
        for what, names in (("read", self.inputs), ("write", self.write.values())):
            twice = _first_duplicate(names)
            if twice is not None:
                raise ValueError(f"{what} of peer '{self.name}' names '{twice}' twice")
        polls = self.is_s7 or self.mode == "poll"
        slowest_ms = self.poll_ms if polls else self.publishing_ms
        if self.read and self.stale_after_ms < 2 * slowest_ms:
            raise ValueError(
                f"stale_after_ms of peer '{self.name}' must be at least twice the interval at which"
                f" values come ({slowest_ms:g} ms), so at least {2 * slowest_ms:g}"
            )
        return self

    @model_validator(mode="after")
    def _fits_transport(self) -> "PeerConfig":
        named = [*self.read, *self.write.values()]
        wrong = next(
            (text for text in named if bool(_BLOCK.match(text)) != self.is_s7), None
        )
        if wrong is not None:
            how = "DB1,REAL4" if self.is_s7 else "nsu=<namespace URI>;s=<name>"
            raise ValueError(f"peer '{self.name}' has no '{wrong}': write {how}")
        if not self.is_s7:
            if self.heartbeat != s7_peer.Heartbeat():
                raise ValueError(
                    f"heartbeat of peer '{self.name}' is for s7://: use sequence_node"
                )
            return self
        polled = "poll" if self.mode == "auto" else self.mode
        for key, given, default in (
            ("security", self.security, PeerSecurity()),
            ("sequence_node", self.sequence_node, None),
            ("mode", polled, "poll"),
        ):
            if given != default:
                raise ValueError(
                    f"{key} of peer '{self.name}' is for opc.tcp://: leave it out"
                )
        try:
            read = named[: len(self.read)]
            s7_peer.check_blocks(read, self.write.values(), self.heartbeat)
        except ValueError as error:
            raise ValueError(f"peer '{self.name}': {error}") from None
        return self

    @property
    def is_s7(self) -> bool:
        """Whether it is an S7 controller."""
        return self.endpoint.startswith(S7)

    @property
    def counter(self) -> str | None:
        """Address of the peer's counter."""
        if self.heartbeat.read:
            return self.heartbeat.read[0]
        return self.sequence_node

    @property
    def counter_modulus(self) -> int:
        """Modulus at which the peer's counter wraps."""
        pair = self.heartbeat.read
        if pair is None:
            return 2**32
        return 1 << 8 * s7.Address.parse(pair[0]).place.size

    @property
    def blocks(self) -> tuple[s7_peer.Block | None, s7_peer.Block | None]:
        """Data blocks of an S7 controller that are read and written."""
        return s7_peer.check_blocks(self.read, self.write.values(), self.heartbeat)

    def inputs_of(self, node: str) -> tuple[str, ...]:
        """Return the inputs that `node` sets; none for a node that is not read."""
        names = self.read.get(node, ())
        return (names,) if isinstance(names, str) else names

    @property
    def inputs(self) -> tuple[str, ...]:
        """All inputs that this peer sets."""
        return tuple(name for node in self.read for name in self.inputs_of(node))

    @property
    def driver(self) -> Driver:
        """The peer."""
        who = (self.name, f"peer:{self.name}", f"peer '{self.name}'")
        return Driver(*who, self.stale_after_ms, self.on_stale)

    @property
    def is_local(self) -> bool:
        """Whether it is a program of this computer."""
        return is_loopback(self.host)

    def about(self, _folder: Path) -> str:
        """Return what it reads and writes, and how it is protected."""
        open_s7 = "unprotected: S7 knows neither users nor encryption"
        how = open_s7 if self.is_s7 else self.security.about
        nodes = f"reads {len(self.read)} and writes {len(self.write)} nodes"
        return f"{self.endpoint}, {nodes}, {how}"

    @property
    def host(self) -> str:
        """Name or address of the peer, without brackets."""
        return urlsplit(self.endpoint).hostname or ""

    @model_validator(mode="after")
    def _password_is_hidden(self) -> "PeerConfig":
        security = self.security
        exposed = security.user is not None and not security.is_secure
        if exposed and not security.allow_clear_password and not is_loopback(self.host):
            raise ValueError(
                f"security of peer '{self.name}': everyone on the network could read the password"
                f" of '{security.user}' with policy None: set policy, for example to"
                " Basic256Sha256, or allow_clear_password: true"
            )
        return self


@dataclass(frozen=True, slots=True)
class SignalProblem:
    """A signal of a peer that does not fit the table."""

    # keys below the peer, e.g. ``("read", "ns=1;s=x")``, or below ``peers``, with its number
    location: tuple[str | int, ...]
    message: str


def check_signals(peer: PeerConfig, table: SignalTable) -> list[SignalProblem]:
    """Return which signal names of `peer` do not fit the signal table."""
    known = {signal.name for signal in table}  # hidden ones are left out
    problems = []
    reader: dict[int, str] = {}
    for node, signal in _reads(peer):
        message = ""
        if signal not in known:
            message = no_signal(
                signal, [name for name in known if table[name].writable]
            )
        elif not table[signal].writable:
            message = f"'{signal}' is an output, so no peer can set it"
        else:
            slots = table[signal].slots
            others = {reader.setdefault(slot, signal) for slot in slots} - {signal}
            if others:
                part, whole = sorted(
                    (signal, min(others)), key=lambda n: len(table[n].slots)
                )
                message = f"'{part}' is part of '{whole}', which is also read: keep one of them"
        if message:
            problems.append(SignalProblem(("read", node), message))
    for signal in peer.write:
        message = ""
        if signal not in known:
            message = no_signal(signal, known)
        elif table[signal].writable:
            message = f"'{signal}' is an input: write sends outputs"
        elif len(table[signal].slots) > 1:
            message = (
                f"'{signal}' is an array: write each of its parts to a separate node"
            )
        if message:
            problems.append(SignalProblem(("write", signal), message))
    return problems


def check_peers(peers: list[PeerConfig]) -> list[SignalProblem]:
    """Return names shared by two peers, and inputs that two peers would set."""
    problems = []
    names = set[str]()
    owner = dict[str, str]()
    for index, peer in enumerate(peers):
        if peer.name in names:
            message = f"two peers have the name '{peer.name}'"
            problems.append(SignalProblem((index, "name"), message))
        names.add(peer.name)
        for node, signal in _reads(peer):
            other = owner.setdefault(signal, peer.name)
            if other != peer.name:
                message = f"'{signal}' is set by two peers, '{other}' and '{peer.name}'"
                problems.append(SignalProblem((index, "read", node), message))
    return problems


def _reads(peer: PeerConfig) -> Iterator[tuple[str, str]]:
    return ((node, signal) for node in peer.read for signal in peer.inputs_of(node))


def _first_duplicate(names: Iterable[str]) -> str | None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return None
