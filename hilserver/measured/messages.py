"""Messages of a topic to numbers, decoded with the definition in the bag or the distribution's."""

import json
from collections.abc import Callable, Sequence
from functools import cache
from types import SimpleNamespace
from typing import Any

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.errors import LogError
from hilserver.logs.bag_messages import Topic
from hilserver.measured.fields import Field

_EDUART = {
    "iotbot_interface/msg/RotationSpeed": (
        "float32 front_left_rpm\nfloat32 front_right_rpm\nfloat32 rear_left_rpm\n"
        "float32 rear_right_rpm\n"
    ),
    "iotbot_interface/msg/Battery": "float32 voltage\n",
}
"""Bags of older recorders hold no definitions, and no distribution has these."""


class TopicError(LogError):
    """A topic that cannot be decoded; the rest of its bag can."""


@cache
def _distribution() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415 -- slow

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _EDUART.items():
        store.register(get_types_from_msg(text, name))
    return store


class Decoder:
    """Reads fields of the messages of one topic.

    Raises
    ------
    TopicError
        If nothing can be decoded: an unknown type, a foreign serialization.
    """

    def __init__(self, where: str, topic: Topic) -> None:
        self._where = where
        self._topic = topic
        self.notices: list[str] = []  # what could not be read
        self.decode = self._decoder()  # bytes to a message

    def _decoder(self) -> Callable[[bytes], Any]:
        topic = self._topic
        if topic.serialization == "json":
            return lambda data: json.loads(
                data, object_hook=lambda d: SimpleNamespace(**d)
            )
        if topic.serialization not in ("cdr", "ros1"):
            raise TopicError(
                f"{self._where}: its messages are"
                f" {topic.serialization or 'of unknown encoding'}; only cdr, ros1 and json can"
                " be read: convert the topic to CSV"
            )
        store, name = self._store(), full_type(topic.type)
        if name not in store.fielddefs:
            raise TopicError(
                f"{self._where}: the definition of its type '{topic.type}' is not in the bag;"
                " record it with ROS 2 Iron or newer, or convert the topic to CSV"
            )
        decode = (
            store.deserialize_ros1
            if topic.serialization == "ros1"
            else store.deserialize_cdr
        )
        return lambda data: decode(data, name)

    def _store(self) -> Any:
        """Return the types of the bag's definition, or of the distribution if it has none."""
        from rosbags.typesys import (  # noqa: PLC0415 -- slow to import
            Stores,
            TypesysError,
            get_types_from_idl,
            get_types_from_msg,
            get_typestore,
        )

        topic = self._topic
        known = _distribution()
        if not topic.definition:
            return known
        try:
            types = (
                get_types_from_idl(topic.definition)
                if topic.encoding == "ros2idl"
                else get_types_from_msg(topic.definition, full_type(topic.type))
            )
            store = get_typestore(Stores.EMPTY)
            store.register({**known.fielddefs, **types})
        except (
            TypesysError,
            ValueError,
            LookupError,
            TypeError,
            RecursionError,
        ) as error:
            self.notices.append(
                f"{self._where}: the definition of its type '{topic.type}' cannot be read"
                f" ({type(error).__name__}); that of ROS 2 Humble is used"
            )
            return known
        return store

    def numbers(
        self,
        messages: Sequence[tuple[int, bytes]],
        fields: Sequence[str],
        *,
        from_header: bool,
    ) -> tuple[Indices, Indices, Array]:
        """Return which messages can be used, their stamps [ns], and fields, shape (n, n_fields).

        NaN if a message does not hold a field.

        Raises
        ------
        TopicError
            If no message can be decoded.
        LogError
            If no message holds a field.
        """
        readers = [Field(path) for path in fields]
        stamps = np.zeros(len(messages), dtype=np.int64)
        values = np.full((len(messages), len(fields)), np.nan)
        decoded = np.zeros(len(messages), dtype=np.bool_)
        elsewhere = np.zeros(len(messages), dtype=np.bool_)
        failed = ""
        for row, (received_ns, data) in enumerate(messages):
            try:
                message = self.decode(data)
                stamp_ns: int | None = received_ns
                if from_header:
                    stamp_ns = _header_ns(self._where, message, readers)
                stamps[row] = stamp_ns or 0
                elsewhere[row] = stamp_ns is None
            except LogError:
                raise
            except Exception as error:  # noqa: BLE001 -- foreign bytes fail decoders in many ways
                failed = type(error).__name__
                continue
            decoded[row] = True
            for column, read in enumerate(readers):
                values[row, column] = read(message)
        if not decoded.any():
            raise TopicError(
                f"{self._where}: none of its messages can be decoded as '{self._topic.type}'"
                f" ({failed}); was the type changed while recording?"
            )
        self._leave_out(
            int((~decoded).sum()), f"messages that cannot be decoded ({failed})"
        )
        self._complain(readers, int(decoded.sum()))
        if from_header:
            unset = decoded & ~elsewhere & (stamps == 0)
            decoded &= stamps != 0
            if not decoded.any():
                raise LogError(
                    f"{self._where}: its headers have no time stamps; use 'stamp: received'"
                )
            self._leave_out(
                int(unset.sum()), "messages without a time stamp in their header"
            )
        return np.flatnonzero(decoded), stamps[decoded], values[decoded]

    def _leave_out(self, count: int, what: str) -> None:
        if count:
            self.notices.append(f"{self._where}: {count} {what} were left out")

    def _complain(self, readers: Sequence[Field], n: int) -> None:
        """Refuse a path that fits no message; count the messages without it."""
        for read in readers:
            if (mistake := read.mistake(n)) is not None:
                raise LogError(f"{self._where}: {mistake}")
        for absent, reason in dict.fromkeys(
            (r.absent, r.reason) for r in readers if r.absent
        ):
            self.notices.append(
                f"{self._where}: {absent} of {n} messages contain no sample: {reason}"
            )


def full_type(name: str) -> str:
    """Return a type as ROS 2 names it; ROS 1 omits the ``msg``."""
    package, _, rest = name.partition("/")
    return name if "/" in rest or not rest else f"{package}/msg/{rest}"


def _header_ns(where: str, message: Any, fields: Sequence[Field]) -> int | None:
    """Return the stamp of what holds the fields; None if that is not in this message."""
    holder = message
    if hasattr(message, "transforms"):
        # each transform of a list has a stamp of its own
        found = (field.transform(message) for field in fields)
        holder = next((one for one in found if one is not None), None)
    if holder is None:
        return None
    try:
        stamp = holder.header.stamp
        rest = stamp.nanosec if hasattr(stamp, "nanosec") else stamp.nsec
        return int(stamp.sec) * 1_000_000_000 + int(rest)
    except AttributeError:
        raise LogError(
            f"{where}: its messages have no header; use 'stamp: received'"
        ) from None
