"""Messages of S7 communication as bytes: RFC 1006, ISO 8073 class 0, S7 jobs read and write.

Only what put and get need. Numbers are big-endian; an address counts bits from the beginning of a
block. There is no public standard; the layout follows the dissectors (Wireshark `s7comm`).
"""

import asyncio
import struct
from collections.abc import Iterable, Sequence
from enum import IntEnum
from typing import Final, NamedTuple

from hilserver.time_limit import time_limit

LONGEST_MESSAGE: Final = 2048  # bytes of one message with its headers
READ_OVERHEAD, WRITE_OVERHEAD = 18, 28
"""Bytes of a message without the data of its only item: answer to a read, job of a write."""
ITEM_OVERHEAD: Final = 17
"""Bytes of each further item of a write, without its data: address, header, padding."""
MOST_ITEMS: Final = 20

_CONNECT, _CONFIRM, _HANG_UP, _DATA = 0xE0, 0xD0, 0x80, 0xF0
_S7, _JOB, _ERROR, _ANSWER, USERDATA = 0x32, 1, 2, 3, 7
ANSWER_HEAD: Final = 12  # bytes of an answer before its parameters
SHORTEST_PDU: Final = 128
_DATA_BLOCK: Final = 0x84
_ADDRESS = struct.Struct(">BBBBHHB3s")
_HEAD = struct.Struct(">BBHHHH")
_SIZES: Final = {1: 1, 2: 1, 3: 1, 4: 2, 5: 2, 6: 4, 7: 4, 8: 4}
"""Bytes per element of an item, by type: bit, byte, character, word, int, dword, dint, real."""
_BIT, _BYTE, _REAL = 1, 2, 8
_AS_BIT, _AS_BYTES, _AS_REAL, _AS_OCTETS = 3, 4, 7, 9


class Function(IntEnum):
    """Function of a job."""

    READ = 4
    WRITE = 5
    SETUP = 0xF0


class Code(IntEnum):
    """Result of an item."""

    DONE = 0xFF
    DENIED = 0x03
    BEYOND = 0x05
    KIND = 0x06
    UNFIT = 0x07
    NO_BLOCK = 0x0A


class WireError(ValueError):
    """Bytes that are not one of these messages."""


class Item(NamedTuple):
    """A piece of a block; `block` is 0 if it is not one."""

    block: int
    bit: int
    size: int
    kind: int = _BYTE

    @property
    def is_bit(self) -> bool:
        """Whether it is one bit; else it is `size` bytes from `bit` on, at a byte boundary."""
        return self.kind == _BIT

    @property
    def bits(self) -> range:
        """Its bits, counted from the beginning of the block."""
        return range(self.bit, self.bit + (1 if self.is_bit else 8 * self.size))

    @property
    def packed(self) -> bytes:
        """Its address."""
        at, count = self.bit.to_bytes(3, "big"), self.size // _SIZES[self.kind]
        return _ADDRESS.pack(
            0x12, 10, 0x10, self.kind, count, self.block, _DATA_BLOCK, at
        )


class S7Message(NamedTuple):
    """A message of either side, parsed as far as they have in common."""

    kind: int
    number: int
    parameters: bytes
    data: bytes
    error: int = 0


# --- frames ---------------------------------------------------------------------------------------


def frame(payload: bytes) -> bytes:
    """Return a message with its headers."""
    return struct.pack(">BBHBBB", 3, 0, len(payload) + 7, 2, _DATA, 0x80) + payload


def connect_request(rack: int, slot: int) -> bytes:
    """Return the request for a connection to a slot, of the kind that panels use."""
    body = bytes((0xC0, 1, 10, 0xC1, 2, 1, 0, 0xC2, 2, 3, rack * 32 + slot))
    return _handshake(_CONNECT, 0, body)


def _handshake(kind: int, to: int, body: bytes) -> bytes:
    head = struct.pack(">BBHHB", 6 + len(body), kind, to, 1, 0)
    return struct.pack(">BBH", 3, 0, 4 + len(head) + len(body)) + head + body


async def receive(
    reader: asyncio.StreamReader, within_s: float | None = None
) -> tuple[int, bytes]:
    """Return kind and payload of the next message.

    `within_s`: how long it may take from its first byte to its last. WireError if it is malformed;
    EOFError if the connection has ended.
    """
    first = await reader.readexactly(1)
    try:
        async with time_limit(within_s):
            return await _rest(first, reader)
    except TimeoutError:
        raise WireError("ends in the middle of a message") from None


async def _rest(head: bytes, reader: asyncio.StreamReader) -> tuple[int, bytes]:
    payload = b""
    while True:
        head += await reader.readexactly(4 - len(head))
        version, _, length = struct.unpack(">BBH", head)
        if version != 3 or not 7 <= length <= LONGEST_MESSAGE:
            raise WireError("is not an ISO-on-TCP message")
        body = await reader.readexactly(length - 4)
        begin = body[0] + 1
        if begin > len(body) or begin < 3:
            raise WireError("has no ISO 8073 header")
        if body[1] & 0xF0 == _HANG_UP:
            raise EOFError("the other side closed the connection")
        if body[1] & 0xF0 != _DATA:
            return body[1] & 0xF0, body[2:]
        payload += body[begin:]
        if len(payload) > LONGEST_MESSAGE:
            raise WireError("is too long")
        if body[2] & 0x80:
            return _DATA, payload
        head = b""


def confirmed(request: tuple[int, bytes]) -> bytes:
    """Return the confirmation of a connection; WireError if none was requested."""
    kind, rest = request
    if kind != _CONNECT or len(rest) < 5:
        raise WireError("is not a connection request")
    theirs = struct.unpack(">H", rest[2:4])[0]
    return _handshake(_CONFIRM, theirs, rest[5:])


def is_confirmed(answer: tuple[int, bytes]) -> bool:
    """Whether a connection was confirmed."""
    return answer[0] == _CONFIRM


# --- jobs -----------------------------------------------------------------------------------------


def job(number: int, parameters: bytes, data: bytes = b"") -> bytes:
    """Return a job, framed."""
    head = _HEAD.pack(_S7, _JOB, 0, number, len(parameters), len(data))
    return frame(head + parameters + data)


def answer(number: int, parameters: bytes, data: bytes = b"", error: int = 0) -> bytes:
    """Return the answer to a job, framed."""
    head = _HEAD.pack(
        _S7, _ANSWER if parameters else _ERROR, 0, number, len(parameters), len(data)
    )
    return frame(head + struct.pack(">H", error) + parameters + data)


def user_data(number: int, parameters: bytes, data: bytes) -> bytes:
    """Return user data, framed."""
    head = _HEAD.pack(_S7, USERDATA, 0, number, len(parameters), len(data))
    return frame(head + parameters + data)


def taken_apart(message: tuple[int, bytes]) -> S7Message:
    """Return a message of either side, parsed; WireError if it is malformed."""
    kind, payload = message
    if kind != _DATA or len(payload) < 10 or payload[0] != _S7:
        raise WireError("is not an S7 message")
    _, what, _, number, n_parameters, n_data = _HEAD.unpack_from(payload)
    start = ANSWER_HEAD if what in (_ANSWER, _ERROR) else 10
    if len(payload) != start + n_parameters + n_data:
        raise WireError("is not as long as its header says")
    error = struct.unpack_from(">H", payload, 10)[0] if start == ANSWER_HEAD else 0
    middle = start + n_parameters
    return S7Message(what, number, payload[start:middle], payload[middle:], error)


def is_job(message: S7Message) -> bool:
    """Whether a message is a job."""
    return message.kind == _JOB and bool(message.parameters)


def setup(pdu_bytes: int, jobs: int = 1) -> bytes:
    """Return the parameters, of either side, that negotiate the length of messages."""
    return struct.pack(">BBHHH", Function.SETUP, 0, jobs, jobs, pdu_bytes)


def agreed(parameters: bytes) -> tuple[int, int]:
    """Return number of parallel jobs and length [bytes] from the parameters of a setup.

    WireError if they are malformed, or permit hardly more than a header.
    """
    if len(parameters) != 8 or parameters[0] != Function.SETUP:
        raise WireError("is not a valid setup")
    jobs, _, pdu_bytes = struct.unpack_from(">HHH", parameters, 2)
    if pdu_bytes < SHORTEST_PDU:
        raise WireError(f"permits only messages of {pdu_bytes} bytes")
    return jobs, pdu_bytes


def asks(function: Function, items: Sequence[Item]) -> bytes:
    """Return the parameters of a job that reads or writes items."""
    return bytes((function, len(items))) + b"".join(item.packed for item in items)


def asked(parameters: bytes) -> list[Item]:
    """Return the items of a job; one that is not a piece of a block has number 0.

    WireError if there are fewer than announced, or too many.
    """
    count = parameters[1] if len(parameters) > 1 else 0
    if not 0 < count <= MOST_ITEMS or len(parameters) != 2 + count * _ADDRESS.size:
        raise WireError("has no items, or too many")
    items = []
    for offset in range(2, len(parameters), _ADDRESS.size):
        spec, _, syntax, kind, n, block, area, at = _ADDRESS.unpack_from(
            parameters, offset
        )
        known = (spec, syntax, area) == (0x12, 0x10, _DATA_BLOCK) and kind in _SIZES
        bit = int.from_bytes(at, "big")
        if (
            not known
            or n == 0
            or (kind == _BIT and n != 1)
            or (kind != _BIT and bit % 8)
        ):
            items.append(Item(0, 0, 0))
        else:
            items.append(Item(block, bit, n * _SIZES[kind], kind))
    return items


def values(pieces: Iterable[tuple[Item, bytes]], code: int = Code.DONE) -> bytes:
    """Return data of items, in the form of an answer to a read or (code 0) of a job of a write."""
    data = b""
    for item, piece in pieces:
        data += b"\0" * (len(data) % 2)
        if item.is_bit:
            data += struct.pack(">BBH", code, _AS_BIT, 1) + piece
        elif item.kind == _REAL:
            data += struct.pack(">BBH", code, _AS_REAL, len(piece)) + piece
        else:
            data += struct.pack(">BBH", code, _AS_BYTES, 8 * len(piece)) + piece
    return data


def refusal(data: bytes, code: Code) -> bytes:
    """Return what follows `data` in an answer for an item that cannot be read."""
    return b"\0" * (len(data) % 2) + struct.pack(">BBH", code, 0, 0)


def pieces(data: bytes, count: int) -> list[tuple[int, bytes]]:
    """Return code and bytes of every item in an answer to a read or a job of a write.

    WireError if there are fewer.
    """
    found, at = [], 0
    for _ in range(count):
        at += at % 2
        if at + 4 > len(data):
            raise WireError("has data for fewer items than announced")
        code, kind, length = struct.unpack_from(">BBH", data, at)
        size = length if kind in (_AS_BIT, _AS_REAL, _AS_OCTETS) else (length + 7) // 8
        piece = data[at + 4 : at + 4 + size]
        if len(piece) != size:
            raise WireError("has less data than announced")
        found.append((code, piece))
        at += 4 + size
    return found
