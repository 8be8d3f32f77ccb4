"""The section ``s7:``, and how data blocks of S7 controllers are written in a configuration.

A place in a block has a type and an offset as shown by TIA Portal: ``at: 4`` and ``type: REAL``,
``at: 6.1`` and ``type: BOOL``. In `peers` one text has both, as in Node-RED's S7 nodes:
``DB1,REAL4`` and ``DB1,X6.1``.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Final, Literal, NamedTuple, Self

from pydantic import AfterValidator, Field, model_validator

from hilserver.config.doors import GRANTS, WRITING, DoorRule, Grant, Right
from hilserver.config.section import Driver, LinkSection, Section
from hilserver.opcua.loopback import is_loopback
from hilserver.signals import MEASURED

BLOCK_BYTES: Final = 8192
"""Longest block; a controller's may be eight times longer, too much to read at 100 Hz."""


class BlockForm(NamedTuple):
    """Memory form of a type: the code of `struct` and its bytes, big-endian."""

    code: str
    size: int


FORMS: Final[Mapping[str, BlockForm]] = {
    "BOOL": BlockForm("?", 1),
    "BYTE": BlockForm("B", 1),
    "SINT": BlockForm("b", 1),
    "USINT": BlockForm("B", 1),
    "WORD": BlockForm("H", 2),
    "INT": BlockForm("h", 2),
    "UINT": BlockForm("H", 2),
    "DWORD": BlockForm("I", 4),
    "DINT": BlockForm("i", 4),
    "UDINT": BlockForm("I", 4),
    "LWORD": BlockForm("Q", 8),
    "LINT": BlockForm("q", 8),
    "ULINT": BlockForm("Q", 8),
    "REAL": BlockForm("f", 4),
    "LREAL": BlockForm("d", 8),
}
_SHORT: Final = {
    "X": "BOOL",
    "B": "BYTE",
    "W": "WORD",
    "I": "INT",
    "DI": "DINT",
    "R": "REAL",
} | {
    "DW": "DWORD",
    "LR": "LREAL",
}
_ADDRESS = re.compile(
    r"^DB(?P<block>\d{1,5}),(?P<type>[A-Z]+)(?P<at>\d{1,5}(?:\.[0-7])?)$"
)
_ENDPOINT = re.compile(
    r"^s7://(?P<host>\[[0-9a-fA-F:.]+\]|[A-Za-z0-9_.-]+)(?::(?P<port>\d{1,5}))?"
    r"/(?P<rack>[0-7])/(?P<slot>\d{1,2})$"
)


@dataclass(frozen=True, slots=True)
class BlockPlace:
    """Place of a value in a block."""

    type: str
    byte: int  # of its first byte
    bit: int = 0  # of a BOOL, else 0

    @classmethod
    def parse(cls, kind: str, at: str) -> Self:
        """Return the place of a type and an offset; ValueError with one sentence if invalid."""
        byte, _, bit = at.partition(".")
        is_number = byte.isdecimal() and bit in ("", *"01234567")
        if not is_number or len(byte) > 5:
            raise ValueError(
                f"at '{at}': write the byte, and for a BOOL byte.bit, as 6.1"
            )
        if (kind == "BOOL") != bool(bit):
            if kind == "BOOL":
                what = "a BOOL has a bit, as 6.1"
            else:
                what = f"a {kind} has no bit"
            raise ValueError(f"at '{at}': {what}")
        place = cls(kind, int(byte), int(bit or 0))
        if place.size > 1 and place.byte % 2:
            raise ValueError(f"at '{at}': a {kind} must start at an even byte")
        if place.end > BLOCK_BYTES:
            raise ValueError(f"at '{at}': a block has at most {BLOCK_BYTES} bytes")
        return place

    @property
    def size(self) -> int:
        """Bytes."""
        return FORMS[self.type].size

    @property
    def end(self) -> int:
        """Byte after the last one."""
        return self.byte + self.size

    @property
    def bits(self) -> range:
        """Its bits, counted from the beginning of the block."""
        first = 8 * self.byte + self.bit
        return range(first, first + (1 if self.type == "BOOL" else 8 * self.size))


class Address(NamedTuple):
    """A place in one of a controller's data blocks."""

    block: int
    place: BlockPlace

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse ``DB1,REAL4``; ValueError with one sentence if it is not an address."""
        match = _ADDRESS.match(text.upper())
        kind = "" if match is None else _SHORT.get(match["type"], match["type"])
        if match is None or kind not in FORMS:
            raise ValueError(
                f"'{text}' is not an address in a data block: write DB1,REAL4 or DB1,X6.1; types"
                f" are"
                f" X, {', '.join(list(FORMS)[1:])}"
            )
        try:
            return cls(int(match["block"]), BlockPlace.parse(kind, match["at"]))
        except ValueError as error:
            raise ValueError(
                f"'{text}' is not an address in a data block: {error}"
            ) from None


class Endpoint(NamedTuple):
    """Address of a controller."""

    host: str
    port: int
    rack: int
    slot: int

    @classmethod
    def parse(cls, text: str) -> Self:
        """Parse ``s7://host:port/rack/slot``; ValueError with one sentence if it is not one."""
        match = _ENDPOINT.match(text)
        if (
            match is None
            or int(match["slot"]) > 31
            or not 0 < int(match["port"] or 102) < 65536
        ):
            raise ValueError(
                f"'{text}' is not an S7 controller: write s7://<host>/<rack>/<slot>, as"
                " s7://192.0.2.20/0/1 for an S7-1500"
            )
        port = int(match["port"] or 102)
        rack = int(match["rack"])
        slot = int(match["slot"])
        return cls(match["host"].strip("[]"), port, rack, slot)


def check_address(text: str) -> str:
    """Check an address and return it unchanged."""
    Address.parse(text)
    return text


def overlap(places: Sequence[BlockPlace]) -> tuple[BlockPlace, BlockPlace] | None:
    """Return the first two places that share a bit."""
    ordered = sorted(places, key=lambda place: place.bits.start)
    for before, after in pairwise(ordered):
        if after.bits.start < before.bits.stop:
            return before, after
    return None


class S7Field(Section):
    """A signal in a block."""

    signal: str = Field(min_length=1, max_length=100, description="Its name")
    at: int | float | str = Field(description="Byte, for a BOOL byte.bit")
    type: Literal[
        "BOOL", "BYTE", "SINT", "USINT", "WORD", "INT", "UINT", "DWORD", "DINT", "UDINT",
        "LWORD", "LINT", "ULINT", "REAL", "LREAL",
    ] = Field("REAL", description="Type in the controller")  # fmt: skip

    @property
    def place(self) -> BlockPlace:
        """Its place in the block."""
        return BlockPlace.parse(self.type, str(self.at))

    @model_validator(mode="after")
    def _usable(self) -> Self:
        _ = self.place
        return self


def _check_layout(fields: tuple[S7Field, ...]) -> tuple[S7Field, ...]:
    twice = overlap([field.place for field in fields])
    if twice is not None:
        names = {field.place: field.signal for field in fields}
        raise ValueError(f"'{names[twice[0]]}' and '{names[twice[1]]}' overlap")
    return fields


Layout = Annotated[
    tuple[S7Field, ...],
    Field(min_length=1, max_length=1000),
    AfterValidator(_check_layout),
]
Number = Annotated[int, Field(ge=1, le=65535)]


class S7Server(Section):
    """Data blocks of ours that controllers and panels read and write by put and get."""

    host: str = Field(
        "127.0.0.1", min_length=1, max_length=253, description="Address to listen on"
    )
    port: int = Field(
        102, ge=0, le=65535, description="ISO-on-TCP; privileged below 1024"
    )
    blocks: Annotated[dict[Number, Layout], Field(min_length=1, max_length=100)] = (
        Field(description="Number of a data block: its signals")
    )
    pdu_bytes: int = Field(
        480, ge=240, le=960, description="Longest message to agree on [bytes]"
    )
    max_clients: int = Field(
        16, ge=1, le=200, description="Connections open at the same time"
    )
    allow_insecure_network: bool = Field(
        False, description="Listen beyond loopback; S7 has neither users nor encryption"
    )
    grants: tuple[Grant, ...] | None = Field(None, max_length=2, description=GRANTS)
    stale_after_ms: float = Field(
        500.0, ge=10, le=3_600_000, description="Values older than this are stale"
    )
    on_stale: Literal["hold", "zero", "ramp"] = Field(
        "ramp", description="What then happens to the set-points of a client"
    )

    @model_validator(mode="after")
    def _closed_to_network(self) -> Self:
        if not is_loopback(self.host) and not self.allow_insecure_network:
            raise ValueError(
                f"host '{self.host}' is reachable from the network, and S7 has no passwords:"
                " listen on 127.0.0.1, or set allow_insecure_network: true"
            )
        return self


class S7Config(LinkSection):
    """S7 controllers and panels as clients of ours; controllers as servers are `peers`."""

    server: S7Server | None = Field(None, description="null: no server")

    @property
    def driver(self) -> Driver:
        """The writers of the blocks."""
        server = self.server
        limit_ms, on_stale = (
            (server.stale_after_ms, server.on_stale) if server else (500.0, "ramp")
        )
        who = ("s7", "peer:s7", "the S7 client")
        return Driver(*who, limit_ms, on_stale, server is not None, has_faults=False)

    @property
    def door(self) -> DoorRule:
        """What clients of our blocks may do."""
        server = self.server
        who = ("S7", self.driver.source, "s7.server.grants")
        if server is None:
            return DoorRule(*who, False, frozenset(), None)
        names = [field.signal for layout in server.blocks.values() for field in layout]
        is_measured = any(name.startswith(MEASURED) for name in names)
        usual = WRITING if is_measured else frozenset({Right.COMMAND})
        return DoorRule(*who, True, usual, server.grants)

    def about(self, _folder: Path) -> str:
        """Return where it listens, and its blocks."""
        server = self.server
        if server is None:
            return ""
        numbers = ", ".join(f"DB{number}" for number in sorted(server.blocks))
        return f"s7://{server.host}:{server.port}, {numbers}"

    @property
    def drives(self) -> bool:
        """Whether a client can command, as a block contains a set-point."""
        layouts = () if self.server is None else self.server.blocks.values()
        return any("setpoint" in field.signal for layout in layouts for field in layout)
