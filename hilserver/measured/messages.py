"""ROS 2 messages to numbers: CDR decoded by the definitions of the bag or of the distribution."""

import dataclasses
import math
import re
from collections.abc import Callable, Sequence
from functools import cache
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import LogError, meant
from hilserver.measured.arrays import Array

_EDUART = {
    "iotbot_interface/msg/RotationSpeed": (
        "float32 front_left_rpm\nfloat32 front_right_rpm\nfloat32 rear_left_rpm\n"
        "float32 rear_right_rpm\n"
    ),
    "iotbot_interface/msg/Battery": "float32 voltage\n",
}
"""Bags of older recorders hold no definitions, and no distribution has these."""

NOT_MEASURED: Final = -1.0
"""First element of a covariance of sensor_msgs/Imu if the sensor does not measure the quantity."""

_STEP = re.compile(r"([A-Za-z_]\w*)((?:\[\d+\])*)\Z")


@cache
def _distribution() -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore  # noqa: PLC0415 -- slow

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, text in _EDUART.items():
        store.register(get_types_from_msg(text, name))
    return store


class Decoder:
    """Reads fields of the messages of one topic.

    Parameters
    ----------
    where : str
        File and topic, for complaints.
    type_name : str
        ``package/msg/Name``.
    definition : str
        As the bag holds it, empty if it holds none.
    encoding : str
        ``ros2msg`` or ``ros2idl``.

    Raises
    ------
    LogError
        When the type is neither in the bag nor in the distribution.
    """

    def __init__(self, where: str, type_name: str, definition: str, encoding: str) -> None:
        self._where, self._type = where, type_name
        self._store = _with_definition(where, type_name, definition, encoding)
        if type_name not in self._store.fielddefs:
            raise LogError(
                f"{where}: the definition of its type '{type_name}' is not in the bag; record it"
                " with ROS 2 Iron or newer, or convert the topic to CSV"
            )

    def numbers(
        self, messages: Sequence[tuple[int, bytes]], fields: Sequence[str], *, from_header: bool
    ) -> tuple[NDArray[np.int64], Array]:
        """Return stamps [ns] and the fields of every message, shapes (n,) and (n, n_fields)."""
        from rosbags.serde import SerdeError  # noqa: PLC0415 -- slow to import

        readers = [_reader(text) for text in fields]
        stamps = np.empty(len(messages), dtype=np.int64)
        values = np.empty((len(messages), len(fields)))
        for row, (received_ns, data) in enumerate(messages):
            try:
                message = self._store.deserialize_cdr(data, self._type)
                stamps[row] = _header_ns(message) if from_header else received_ns
            except (SerdeError, ValueError, IndexError, TypeError) as error:
                raise LogError(
                    f"{self._where}: message {row + 1} cannot be decoded as '{self._type}'"
                    f" ({type(error).__name__}); was the type changed while recording?"
                ) from None
            except AttributeError:
                raise LogError(
                    f"{self._where}: its messages have no header; take 'stamp: received'"
                ) from None
            for column, read in enumerate(readers):
                values[row, column] = self._read(read, message, fields[column])
        return stamps, values

    def _read(self, read: Callable[[Any], float], message: Any, text: str) -> float:
        try:
            return read(message)
        except AttributeError:
            known = _fields(message)
            hint = meant(text, known, f"it has {', '.join(known):.200}")
            raise LogError(f"{self._where}: there is no field '{text}'; {hint}") from None
        except IndexError:
            raise LogError(
                f"{self._where}: the list in field '{text}' is shorter; count from 0"
            ) from None
        except (TypeError, ValueError):
            raise LogError(f"{self._where}: field '{text}' is no number; name one") from None


def _with_definition(where: str, type_name: str, definition: str, encoding: str) -> Any:
    from rosbags.typesys import (  # noqa: PLC0415 -- slow to import
        TypesysError,
        get_types_from_idl,
        get_types_from_msg,
    )

    store = _distribution()
    if type_name in store.fielddefs or not definition:
        return store
    try:
        types = (
            get_types_from_idl(definition)
            if encoding == "ros2idl"
            else get_types_from_msg(definition, type_name)
        )
        store.register(
            {name: fields for name, fields in types.items() if name not in store.fielddefs}
        )
    except (TypesysError, ValueError, KeyError) as error:
        raise LogError(
            f"{where}: the definition of its type '{type_name}' is damaged"
            f" ({type(error).__name__}); convert the topic to CSV"
        ) from None
    return store


def _header_ns(message: Any) -> int:
    stamp = message.header.stamp
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def _reader(text: str) -> Callable[[Any], float]:
    """Return a function that takes a number out of a message.

    ``a.b.c`` and ``list[2]``; ``yaw`` of a quaternion, which has no such field, is computed. What
    its covariance marks as not measured (sensor_msgs/Imu) is NaN.
    """
    steps: list[str | int] = []
    for part in text.split("."):
        match = _STEP.match(part)
        steps.append(part if match is None else match[1])
        if match is not None:
            steps += [int(number) for number in re.findall(r"\d+", match[2])]

    def read(message: Any) -> float:
        covariance = getattr(message, f"{steps[0]}_covariance", (0.0,))
        if covariance[0] == NOT_MEASURED:
            return math.nan
        for step in steps:
            if isinstance(step, int):
                message = message[step]
            elif step == "yaw" and hasattr(message, "w"):
                return _yaw(message)
            else:
                message = getattr(message, step)
        return float(message)

    return read


def _yaw(q: Any) -> float:
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), 1.0 - 2.0 * (q.y**2 + q.z**2))


def _fields(message: Any, prefix: str = "") -> list[str]:
    """Return the numbers that a message has, by their paths."""
    found = []
    for item in dataclasses.fields(message):
        value = getattr(message, item.name)
        if dataclasses.is_dataclass(value):
            found += _fields(value, f"{prefix}{item.name}.")
        elif not item.name.startswith("__"):
            found.append(f"{prefix}{item.name}")
    return found
