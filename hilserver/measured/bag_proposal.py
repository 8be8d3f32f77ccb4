"""A mapping file for a foreign bag, guessed from its types, its topics and the names in them."""

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from hilserver.errors import LogError
from hilserver.logs.bag_messages import Topic, read_messages
from hilserver.measured.channels import GYRO, IMU_YAW, NAV_X, NAV_Y, TWIST, VOLTAGE, YAW
from hilserver.measured.fields import items_of, names_of
from hilserver.measured.mapping import builtin_mappings, load_mapping
from hilserver.measured.messages import Decoder, full_type
from hilserver.measured.proposal import (
    ODOMETRY,
    SENT,
    ForeignLog,
    line,
    lines,
    meanings,
    quoted,
    text,
    words_of,
)

_READ: Final = 20  # messages of a topic: publishers may take turns
_LONGEST: Final = 16  # a longer list is an image or a scan
_BESIDE: Final = ("header", "effort")  # what a message holds besides our measurements
_POSE: Final = {"position.x": NAV_X, "position.y": NAV_Y, "orientation.yaw": YAW}
_COMMAND: Final = dict(zip(("linear.x", "angular.z"), TWIST, strict=True))
_JOINTS: Final = "sensor_msgs/msg/JointState"
_ODOMETRY: Final = "nav_msgs/msg/Odometry"


def _below(place: str, fields: Mapping[str, str]) -> Mapping[str, str]:
    return {f"{place}.{field}": signal for field, signal in fields.items()}


_MEASURED: Final[Mapping[str, Mapping[str, str]]] = {
    "sensor_msgs/msg/BatteryState": {"voltage": VOLTAGE},
    "sensor_msgs/msg/Imu": {
        "angular_velocity.z": GYRO,
        "orientation.yaw": IMU_YAW,
        "linear_acceleration.x": "imu.accel_x_m_s2",
        "linear_acceleration.y": "imu.accel_y_m_s2",
    },
    "geometry_msgs/msg/PointStamped": {"point.x": NAV_X, "point.y": NAV_Y},
    "geometry_msgs/msg/PoseStamped": _below("pose", _POSE),
    "geometry_msgs/msg/PoseWithCovarianceStamped": _below("pose.pose", _POSE),
    "geometry_msgs/msg/TransformStamped": {
        "transform.translation.x": NAV_X,
        "transform.translation.y": NAV_Y,
        "transform.rotation.yaw": YAW,
    },
    _ODOMETRY: _below("pose.pose", _POSE),
}
_COMMANDED: Final[Mapping[str, Mapping[str, str]]] = {
    "geometry_msgs/msg/Twist": _COMMAND,
    "geometry_msgs/msg/TwistStamped": _below("twist", _COMMAND),
}
_ALSO_SENT: Final = {"joy", "teleop", "initialpose", "clicked"}
_OF_ROS: Final = re.compile(
    r"((diagnostic|geometry|nav|rosgraph|sensor|tf2|visualization)_msgs|rcl_interfaces)/"
)
"""Packages whose other types hold nothing of ours: images, scans, magnetic fields."""


def refuse_unmapped(path: Path) -> NoReturn:
    """Raise ForeignLog: a foreign bag needs a mapping; one is named or proposed."""
    bags = read_messages(path, set())
    topics = {name: topic for bag in bags for name, topic in bag.topics.items()}
    fitting = next((name for name in builtin_mappings() if _fits(name, topics)), None)
    offer = (
        f"{fitting} with --mapping, which fits" if fitting else "a file with --mapping"
    )
    known = ", ".join(
        f"{name} ({topic.type})" for name, topic in sorted(topics.items())
    )
    raise ForeignLog(
        f"{path}: a bag needs a mapping of its topics; give {offer}; its topics are {known:.600}",
        "" if fitting else _proposal(path, topics),
    )


def _fits(mapping: str, topics: Mapping[str, Topic]) -> bool:
    channels = load_mapping(mapping).channels.values()
    return all(channel.optional or channel.topic in topics for channel in channels)


def _proposal(path: Path, topics: Mapping[str, Topic]) -> str:
    """Return the text of a mapping file; empty without a guess."""
    kinds = {name: full_type(topic.type) for name, topic in topics.items()}
    wanted = {name for name, kind in kinds.items() if _may_be_ours(kind)}
    try:
        bags = read_messages(path, wanted, _READ)
    except LogError:  # messages too large
        return ""
    channels: dict[str, str] = {}
    # A pose derived from the wheels' speeds comes last: it shows none of their errors.
    for name in sorted(
        wanted, key=lambda n: (bool(words_of(n) & ODOMETRY), kinds[n] == _ODOMETRY, n)
    ):
        sent = [data for bag in bags for _, data in bag.messages.get(name, ())]
        if sent:
            for signal, found in _guesses(name, topics[name], sent):
                channels.setdefault(signal, found)
    return text(channels)


def _may_be_ours(kind: str) -> bool:
    return (
        kind in _MEASURED
        or kind in _COMMANDED
        or kind == _JOINTS
        or not _OF_ROS.match(kind)
    )


def _guesses(name: str, topic: Topic, sent: list[bytes]) -> Iterator[tuple[str, str]]:
    """Yield signals of a topic, each with its line of a mapping file."""
    kind, words = full_type(topic.type), words_of(name)
    at = f"topic: {quoted(name)}, field: "
    by_type = _COMMANDED if words & {*SENT, *_ALSO_SENT} else _MEASURED
    if kind in _MEASURED or kind in _COMMANDED:
        for field, signal in by_type.get(kind, {}).items():
            yield signal, line(signal, field, words, at + quoted(field))
        return
    fields = _fields(name, topic, sent)
    full = [f"{name}.{field}" for field in fields]
    for field, long, meant in zip(fields, full, meanings(full, ()), strict=True):
        yield from lines(long, meant, at + quoted(field))


def _fields(name: str, topic: Topic, sent: list[bytes]) -> list[str]:
    """Return the numbers in the messages of a topic, speeds first."""
    found: dict[str, None] = {}
    try:
        decode = Decoder(name, topic).decode
        for data in sent:
            found |= dict.fromkeys(_numbers(decode(data)))
    except Exception:  # noqa: BLE001 -- foreign bytes fail decoders in many ways
        return []
    return sorted(found, key=lambda field: not field.startswith("velocity"))


def _numbers(message: Any, place: str = "") -> Iterator[str]:
    """Yield the paths of the numbers in a message; for lists those of their elements."""
    for name, value in items_of(message):
        at = place + name
        if name in _BESIDE or name.startswith("__") or name.endswith("covariance"):
            continue
        if hasattr(value, "w"):
            yield f"{at}.yaw"
        elif isinstance(value, list | np.ndarray):
            names = names_of(message, value) or range(min(len(value), _LONGEST + 1))
            for label, item in (
                zip(names, value, strict=False) if len(value) <= _LONGEST else ()
            ):
                yield from _elements(item, f"{at}[{label}]")
        elif items_of(value):
            yield from _numbers(value, f"{at}.")
        elif isinstance(value, int | float):
            yield at


def _elements(item: Any, at: str) -> Iterator[str]:
    if items_of(item):
        yield from _numbers(item, f"{at}.")
    elif not isinstance(item, str):
        yield at
