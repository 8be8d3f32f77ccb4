"""Frames of OPC UA's TCP transport (OPC 10000-6, 7.1), cut out of an untrusted stream.

Nothing is buffered that the sender is not entitled to send: a header is checked before its body is
awaited, and the accepted messages depend on the stage of the connection.
"""

import struct
from collections.abc import Iterator
from enum import IntEnum

from asyncua import ua

_HEADER = struct.Struct("<3scI")
_MIN_BYTES = {b"HEL": 32, b"OPN": 24, b"MSG": 24, b"CLO": 24, b"ERR": 16}
MAX_HELLO_BYTES = 8 + 24 + 4096
MAX_CHUNK_BYTES = 65_535
_Codes = ua.StatusCodes


class ConnectionStage(IntEnum):
    """Stage of a connection."""

    NEW = 0
    GREETED = 1
    OPEN = 2
    ACTIVE = 3


_ALLOWED = {
    ConnectionStage.NEW: {b"HEL"},
    ConnectionStage.GREETED: {b"OPN"},
    ConnectionStage.OPEN: {b"OPN", b"MSG", b"CLO"},
    ConnectionStage.ACTIVE: {b"OPN", b"MSG", b"CLO"},
}


class TransportError(Exception):
    """The connection is refused: the code goes out in an Error message, then it is closed."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(text)
        self.code = code


class FrameReader:
    """Collects bytes and returns whole frames."""

    def __init__(self) -> None:
        self._buffer = bytearray()
        # start of the frame that is still incomplete [s]; None without one
        self.since_s: float | None = None

    def feed(self, data: bytes, now_s: float) -> Iterator[tuple[bytes, bytes]]:
        """Add received bytes; yield message type and whole frame, in order.

        TransportError if a header is invalid, or announces more than is accepted.
        """
        self._buffer += data
        if self.since_s is None and self._buffer:
            self.since_s = now_s
        while len(self._buffer) >= _HEADER.size:
            kind, chunk, size = _HEADER.unpack_from(self._buffer)
            if kind not in _MIN_BYTES or chunk not in (b"F", b"C", b"A"):
                raise TransportError(
                    _Codes.BadTcpMessageTypeInvalid, "not an OPC UA message"
                )
            if chunk != b"F" and kind != b"MSG":
                raise TransportError(
                    _Codes.BadTcpMessageTypeInvalid, "only messages have chunks"
                )
            if size > (MAX_HELLO_BYTES if kind == b"HEL" else MAX_CHUNK_BYTES):
                raise TransportError(_Codes.BadTcpMessageTooLarge, "larger than agreed")
            if size < _MIN_BYTES[kind]:
                raise TransportError(
                    _Codes.BadDecodingError, "too short for its message type"
                )
            if len(self._buffer) < size:
                return
            frame = bytes(self._buffer[:size])
            del self._buffer[:size]
            self.since_s = now_s if self._buffer else None
            yield kind, frame


def check_order(stage: ConnectionStage, kind: bytes) -> None:
    """Raise TransportError if a message of that type is not allowed at this stage."""
    if kind not in _ALLOWED[stage]:
        if kind == b"MSG":
            raise TransportError(
                _Codes.BadTcpSecureChannelUnknown, "no channel is open"
            )
        raise TransportError(_Codes.BadTcpMessageTypeInvalid, "not at this point")
