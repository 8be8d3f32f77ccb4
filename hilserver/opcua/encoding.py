"""The bytes of the most frequent messages: values, Publish and Read.

asyncua's general codec costs 20 us per value; here a value is encoded once for all its readers and
subscribers, and the two most frequent requests are parsed with `struct`. Layouts are those of
OPC 10000-6, 5.2; anything unexpected is left to asyncua.
"""

import functools
import struct
import time
from collections.abc import Generator
from datetime import UTC, datetime
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.common.utils import Buffer, ServiceError
from asyncua.ua.ua_binary import Primitives, nodeid_from_binary, variant_to_binary

_GOOD = ua.StatusCode(ua.StatusCodes.Good)
FILETIME_OF_1970 = 116_444_736_000_000_000
_SCALARS = {
    kind: struct.Struct("<B" + letter)
    for kind, letter in {
        ua.VariantType.Boolean: "?",
        ua.VariantType.Byte: "B",
        ua.VariantType.UInt32: "I",
        ua.VariantType.Int64: "q",
        ua.VariantType.Double: "d",
    }.items()
}
_HAS_VALUE, _HAS_STATUS, _HAS_SOURCE, _HAS_SERVER = 1, 2, 4, 8
# by number of TimestampsToReturn
_MASKS = (_HAS_SOURCE, _HAS_SERVER, _HAS_SOURCE | _HAS_SERVER, 0)
_U32, _I32 = struct.Struct("<I"), struct.Struct("<i")
_RESPONSE = struct.Struct("<4sqIIBi3s")
_REQUEST = struct.Struct("<qIIiI3s")
_NONE = struct.pack("<i", -1)
_NULL_HEADER = b"\0\0\0"
_FOUR_BYTES = b"\1\0"  # node id in four bytes, namespace 0 (OPC 10000-6, 5.2.2.9)


def binary_id(name: str) -> int:
    """Return the identifier of a structure's binary encoding in namespace 0."""
    return int(getattr(ua.ObjectIds, f"{name}_Encoding_DefaultBinary"))


def numeric_id(identifier: int) -> bytes:
    """Return a numeric node id of namespace 0."""
    return _FOUR_BYTES + struct.pack("<H", identifier)


_PUBLISH_RESPONSE = numeric_id(binary_id("PublishResponse"))
_READ_RESPONSE = numeric_id(binary_id("ReadResponse"))
DATA_CHANGE = numeric_id(binary_id("DataChangeNotification"))
EVENTS = numeric_id(binary_id("EventNotificationList"))
STATUS_CHANGE = numeric_id(binary_id("StatusChangeNotification"))


class FixedDataValue(ua.DataValue):  # type: ignore[misc]
    """A DataValue that does not change after it is made: encoded once for all clients."""

    @functools.cached_property
    def _encoded(self) -> dict[int, bytes]:
        return {}

    @classmethod
    def of(cls, value: ua.DataValue) -> "FixedDataValue":
        """Return `value` as one that does not change."""
        if isinstance(value, cls):
            return value
        return cls(
            value.Value, value.StatusCode, value.SourceTimestamp, value.ServerTimestamp
        )

    @classmethod
    def good(
        cls, value: Any, kind: ua.VariantType, *, is_array: bool | None = None
    ) -> "FixedDataValue":
        """Return a value with status Good and the stamp of now."""
        now = datetime.now(UTC)
        return cls(ua.Variant(value, kind, None, is_array), _GOOD, now, now)

    @functools.cached_property
    def content(self) -> bytes:
        """Encoded value and status, without stamps, compared to detect a change."""
        return self._value_bytes() + _U32.pack(self.code)

    @property
    def code(self) -> int:
        """Status code as a number."""
        return 0 if self.StatusCode is None else int(self.StatusCode.value)

    def _value_bytes(self) -> bytes:
        variant = self.Value
        if variant is None or variant.VariantType is ua.VariantType.Null:
            return b""
        scalar = _SCALARS.get(variant.VariantType)
        if scalar is None or variant.is_array:
            return bytes(variant_to_binary(variant))
        return scalar.pack(variant.VariantType.value, variant.Value)

    def encoded(self, stamps: int) -> bytes:
        """Return the bytes of the value with the requested time stamps.

        `stamps`: number of a TimestampsToReturn.
        """
        found = self._encoded.get(stamps)
        if found is None:
            mask = _MASKS[stamps]
            content = self.content
            mask |= _HAS_STATUS
            if len(content) > _U32.size:
                mask |= _HAS_VALUE
            dates = b""
            for bit, stamp in (
                (_HAS_SOURCE, self.SourceTimestamp),
                (_HAS_SERVER, self.ServerTimestamp),
            ):
                if stamp is None:
                    mask &= ~bit
                elif mask & bit:
                    dates += _date(stamp)
            found = self._encoded[stamps] = bytes((mask,)) + content + dates
        return found

    def __deepcopy__(self, memo: dict[int, Any]) -> "FixedDataValue":
        return self


@functools.lru_cache(maxsize=256)
def _date(stamp: datetime) -> bytes:
    return bytes(Primitives.DateTime.pack(stamp))


def filetime_now() -> int:
    """Return the present time in units of OPC UA: 100 ns since 1601."""
    return time.time_ns() // 100 + FILETIME_OF_1970


# --- responses ------------------------------------------------------------------------------------


def response_head(type_id: bytes, handle: int, code: int = 0) -> bytes:
    """Return type and header of a response without diagnostics."""
    return _RESPONSE.pack(type_id, filetime_now(), handle, code, 0, 0, _NULL_HEADER)


def read_response(handle: int, values: list[bytes]) -> bytes:
    """Return a Read response."""
    head = response_head(_READ_RESPONSE, handle)
    return b"".join((head, _I32.pack(len(values)), *values, _NONE))


def extension(type_id: bytes, *parts: bytes) -> bytes:
    """Return an extension object."""
    body = b"".join(parts)
    return type_id + b"\x01" + _I32.pack(len(body)) + body


def notification_list(type_id: bytes, parts: list[bytes]) -> bytes:
    """Return a DataChangeNotification or an EventNotificationList of encoded items."""
    tail = _NONE if type_id is DATA_CHANGE else b""
    return extension(type_id, _I32.pack(len(parts)), *parts, tail)


def notification_message(sequence: int, data: list[bytes]) -> bytes:
    """Return a NotificationMessage of encoded notifications."""
    head = struct.pack("<Iqi", sequence, filetime_now(), len(data))
    return b"".join((head, *data))


def publish_response(
    handle: int,
    subscription: int,
    available: list[int],
    more: bool,
    message: bytes,
    results: bytes,
) -> bytes:
    """Return a Publish response."""
    numbers = struct.pack(
        f"<Ii{len(available)}I?", subscription, len(available), *available, more
    )
    head = response_head(_PUBLISH_RESPONSE, handle)
    return b"".join((head, numbers, message, results, _NONE))


def status_codes(codes: list[int]) -> bytes:
    """Return an array of status codes."""
    return struct.pack(f"<i{len(codes)}I", len(codes), *codes)


# --- requests -------------------------------------------------------------------------------------


def service_id(body: Buffer) -> Any:
    """Read the type of a request from `body`; None if it is not of namespace 0."""
    if body._data[body.cur_pos : body.cur_pos + 2] == _FOUR_BYTES:
        return int.from_bytes(body.read(4)[2:], "little")
    type_id = nodeid_from_binary(body)
    return type_id.Identifier if type_id.NamespaceIndex == 0 else None


def utc_now() -> int:
    """Return the time of now as UtcTime [100 ns]."""
    return time.time_ns() // 100 + FILETIME_OF_1970


class RequestHead(NamedTuple):
    """The needed fields of a request header."""

    handle: int
    diagnostics: int
    timeout_ms: int
    sent: int  # UtcTime of the client [100 ns]; 0: it gave none


def request_head(body: Buffer, token: bytes) -> RequestHead | None:
    """Read the header of a request with `token` from `body`; None if it looks different.

    `token`: encoded authentication token of the session.
    """
    start = body.cur_pos
    end = start + len(token)
    is_too_short = len(body) < len(token) + _REQUEST.size
    if is_too_short or body._data[start:end] != token:
        return None
    sent, handle, diagnostics, audit_id, timeout_ms, more = _REQUEST.unpack_from(
        body._data, end
    )
    if audit_id > 0 or more != _NULL_HEADER:
        return None
    body.skip(len(token) + _REQUEST.size)
    return RequestHead(handle, diagnostics, timeout_ms, sent)


def acknowledgements(body: Buffer) -> list[tuple[int, int]]:
    """Return subscriptions and sequence numbers that a Publish request acknowledges."""
    (count,) = _I32.unpack(body.read(4))
    numbers = struct.unpack(f"<{2 * max(count, 0)}I", body.read(8 * max(count, 0)))
    return list(zip(numbers[::2], numbers[1::2], strict=True))


class ReadItem(NamedTuple):
    """One item of a Read request."""

    node_id: Any
    attribute: int
    index_range: str
    data_encoding: ua.QualifiedName


class ReadItems(NamedTuple):
    """A Read request."""

    max_age_ms: float
    stamps: int
    items: list[ReadItem]


_NO_ENCODING = ua.QualifiedName()


def read_items(body: Buffer, most: int) -> Generator[None, None, ReadItems]:
    """Parse a Read request; BadTooManyOperations beyond `most` items."""
    max_age_ms, stamps, count = struct.unpack("<dii", body.read(16))
    if count > most:
        raise ServiceError(ua.StatusCodes.BadTooManyOperations)
    items = []
    for _ in range(count):
        yield
        node_id = nodeid_from_binary(body)
        attribute = int.from_bytes(body.read(4), "little")
        index_range = Primitives.String.unpack(body) or ""
        namespace = int.from_bytes(body.read(2), "little")
        name = Primitives.String.unpack(body)
        if name or namespace:
            encoding = ua.QualifiedName(name, namespace)
        else:
            encoding = _NO_ENCODING
        items.append(ReadItem(node_id, attribute, index_range, encoding))
    return ReadItems(max_age_ms, stamps, items)
