"""The common payload format of the Industrial Edge databus, version 1: topics and messages.

Bytes in and out, without a connection: the content of messages is defined here.
"""

import json
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from fnmatch import fnmatchcase
from typing import Any, Final

from pydantic_core import from_json

from hilserver import __version__
from hilserver.config.edge import EdgeConfig, EdgeGroup
from hilserver.errors import ConfigError
from hilserver.image import Frame
from hilserver.signals import Signal, SignalTable, ValueType
from hilserver.status import is_bad

DATA_TYPES: Final = {
    ValueType.DOUBLE: "LReal",
    ValueType.BOOLEAN: "Bool",
    ValueType.BYTE: "Byte",
    ValueType.UINT32: "UDInt",
    ValueType.INT64: "LInt",
}
BAD, UNCERTAIN, GOOD = 0, 1, 3  # quality; 3 is good and usable in control
MOST_BYTES: Final = 65_536  # longest message that is read


@dataclass(frozen=True)
class Collection:
    """A group with its signals and topics."""

    group: EdgeGroup
    signals: tuple[Signal, ...]  # scalars; the slot of one is its id
    topic: str
    write_topic: str  # empty if no writes are accepted

    @property
    def inputs(self) -> dict[str, Signal]:
        """Signals that may be written, by id."""
        writable = self.signals if self.write_topic else ()
        return {_id(signal): signal for signal in writable if signal.writable}


def collections_of(config: EdgeConfig, table: SignalTable) -> list[Collection]:
    """Return the groups of a configuration with their signals.

    ConfigError if a pattern matches no signal.
    """
    scalars = [signal for signal in table.scalars if not signal.hidden]
    found = []
    for group in config.groups:
        for pattern in group.signals:
            if not any(fnmatchcase(signal.name, pattern) for signal in scalars):
                raise ConfigError(
                    f"group '{group.name}': no signal matches '{pattern}'; see 'hilserver signals'"
                )
        signals = tuple(
            signal
            for signal in scalars
            if any(fnmatchcase(signal.name, pattern) for pattern in group.signals)
        )
        base = f"ie/d/j/simatic/v1/{config.id}/dp"
        place = f"{config.connection}/{group.name}"
        write_topic = f"{base}/w/{place}" if group.writable else ""
        found.append(Collection(group, signals, f"{base}/r/{place}", write_topic))
    return found


def metadata_topic(config: EdgeConfig) -> str:
    """Return the topic of the metadata (retained)."""
    return f"ie/m/j/simatic/v1/{config.id}/dp"


def status_topic(config: EdgeConfig) -> str:
    """Return the topic of the status."""
    return f"ie/s/j/simatic/v1/{config.id}/status"


def metadata(
    config: EdgeConfig, collections: Iterable[Collection], number: int
) -> bytes:
    """Return the message that describes all others."""
    points = [_described(collection) for collection in collections]
    connection = {"name": config.connection, "type": "hilserver", "dataPoints": points}
    # A number that changes only if the data points change.
    digest = 0
    for byte in _json(points):
        digest = (digest * 31 + byte) & 0x7FFF_FFFF
    return _json(
        {
            "seq": number,
            "hashVersion": digest,
            "applicationName": f"hilserver {__version__}",
            "statustopic": status_topic(config),
            "connections": [connection],
        }
    )


def _described(collection: Collection) -> dict[str, Any]:
    written = {"pubTopic": collection.write_topic} if collection.write_topic else {}
    definitions = [
        {
            "name": signal.name,
            "id": _id(signal),
            "dataType": DATA_TYPES[signal.type],
        }
        for signal in collection.signals
    ]
    return {
        "name": collection.group.name,
        "topic": collection.topic,
        **written,
        "publishType": "bulk",
        "dataPointDefinitions": definitions,
    }


def status(config: EdgeConfig, number: int, utc_ns: int, *, available: bool) -> bytes:
    """Return birth message or last will."""
    connections = [
        {"name": config.connection, "status": "good" if available else "bad"}
    ]
    return _json(
        {
            "seq": number,
            "ts": _timestamp(utc_ns),
            "connector": {"status": "available" if available else "unavailable"},
            "connections": connections,
        }
    )


def values(collection: Collection, frame: Frame, number: int, utc_ns: int) -> bytes:
    """Return the values of a group in one frame; `utc_ns` is the frame's planned time."""
    timestamp = _timestamp(utc_ns)
    points = [
        {
            "id": _id(signal),
            "val": _value(signal, frame),
            "ts": timestamp,
            "qc": _quality(code),
        }
        for signal in collection.signals
        for code in (int(frame.status[signal.slots[0]]),)
    ]
    return _json({"seq": number, "vals": points})


def _value(signal: Signal, frame: Frame) -> float | str | bool:
    number = float(frame.values[signal.slots[0]])
    if signal.type is ValueType.DOUBLE:
        return number if math.isfinite(number) else 0.0
    if signal.type is ValueType.BOOLEAN:
        return bool(number)
    if signal.type is ValueType.INT64:
        return str(int(number))
    return int(number)


def _quality(code: int) -> int:
    if is_bad(code):
        return BAD
    return UNCERTAIN if code & 0x4000_0000 else GOOD


def written(collection: Collection, data: bytes) -> Mapping[str, object]:
    """Return the values that a message writes, by signal name.

    ValueError with a sentence if the message is not a write of this group.
    """
    if len(data) > MOST_BYTES:
        raise ValueError(f"{len(data)} bytes are more than a group has")
    try:
        # Python's own recurses as deep as a stranger's message nests
        message = from_json(data)
    except ValueError:
        raise ValueError("is not JSON") from None
    points = message.get("vals") if isinstance(message, dict) else None
    if not isinstance(points, list):
        raise ValueError("has no list 'vals'")
    inputs = collection.inputs
    found = {}
    for point in points:
        if not isinstance(point, dict) or not {"id", "val"} <= point.keys():
            raise ValueError("has an entry without 'id' or 'val' in 'vals'")
        signal = inputs.get(str(point["id"])[:20])
        if signal is None:
            raise ValueError(f"id {point['id']!s:.20} is not an input of the group")
        found[signal.name] = _number(signal, point["val"])
    return found


def _number(signal: Signal, value: object) -> object:
    """Return a number that came as text, the form of 64-bit integers, as a number."""
    if signal.type is ValueType.INT64 and isinstance(value, str):
        digits = value.removeprefix("-")
        if len(digits) <= 19 and digits.isascii() and digits.isdigit():
            return int(value)
    return value


def _id(signal: Signal) -> str:
    return str(signal.slots[0])


def _timestamp(utc_ns: int) -> str:
    moment = datetime.fromtimestamp(utc_ns // 1_000_000_000, UTC)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{utc_ns // 1_000_000 % 1000:03d}Z"


def _json(content: object) -> bytes:
    return json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
