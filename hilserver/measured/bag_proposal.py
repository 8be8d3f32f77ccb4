"""A mapping file for a foreign bag, guessed from its types, its topics and the names in them."""

import contextlib
import re
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any, Final, NoReturn

import numpy as np

from hilserver.errors import LogError
from hilserver.logs.bag_messages import Bag, Topic, read_messages
from hilserver.measured.builtin import builtin_mappings
from hilserver.measured.candidates import Candidate, choose, has_wheels
from hilserver.measured.channels import (
    FIX_LATITUDE,
    FIX_LONGITUDE,
    FIX_VARIANCE,
    GYRO,
    IMU_YAW,
    NAV_X,
    NAV_Y,
    TWIST,
    VOLTAGE,
    YAW,
)
from hilserver.measured.evidence import samples
from hilserver.measured.fields import Field, items_of, names_of
from hilserver.measured.mapping import load_mapping
from hilserver.measured.messages import Decoder, full_type
from hilserver.measured.other_machines import refuse_other_machine
from hilserver.measured.proposal import (
    ODOMETRY,
    SENT,
    TRUTH,
    ForeignLog,
    line,
    lines,
    meanings,
    quoted,
    text,
    words_of,
)

_READ: Final = (4000, 20)  # messages of a topic; fewer if they are large
_SEEN: Final = 400  # of them are decoded, evenly
_LONGEST: Final = 16  # a longer list is an image or a scan
_BESIDE: Final = ("header", "effort")  # what a message holds besides our measurements
_POSE: Final = {"position.x": NAV_X, "position.y": NAV_Y, "orientation.yaw": YAW}
_COMMAND: Final = dict(zip(("linear.x", "angular.z"), TWIST, strict=True))
_JOINTS: Final = "sensor_msgs/msg/JointState"
_ODOMETRY: Final = "nav_msgs/msg/Odometry"
_TRANSFORMS: Final = "tf2_msgs/msg/TFMessage"
_MOVES_M: Final = 0.1  # m; a frame that moves less is a part of the robot


def _below(place: str, fields: Mapping[str, str]) -> Mapping[str, str]:
    return {f"{place}.{field}": signal for field, signal in fields.items()}


_MEASURED: Final[Mapping[str, Mapping[str, str]]] = {
    "sensor_msgs/msg/BatteryState": {"voltage": VOLTAGE},
    "sensor_msgs/msg/Imu": {
        "angular_velocity.z": GYRO,
        "angular_velocity.x": GYRO,
        "angular_velocity.y": GYRO,
        "orientation.yaw": IMU_YAW,
        "linear_acceleration.x": "imu.accel_x_m_s2",
        "linear_acceleration.y": "imu.accel_y_m_s2",
    },
    "sensor_msgs/msg/NavSatFix": {
        "latitude": FIX_LATITUDE,
        "longitude": FIX_LONGITUDE,
        "position_covariance[0]": FIX_VARIANCE,
    },
    "geometry_msgs/msg/Pose": _POSE,
    "geometry_msgs/msg/Pose2D": {"x": NAV_X, "y": NAV_Y, "theta": YAW},
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
_LOCALIZERS: Final = {
    "amcl",
    "slam",
    "localization",
    "cartographer",
    "hector",
    "rtabmap",
    "icp",
}
"""In the names of poses that a map of the surroundings shows."""
_ALSO_SENT: Final = {"joy", "teleop", "initialpose", "clicked"}
_OF_ROS: Final = re.compile(
    r"((diagnostic|geometry|nav|rosgraph|sensor|tf2|visualization)_msgs|rcl_interfaces)/"
)
"""Packages whose other types hold nothing of ours: images, scans, magnetic fields."""


def refuse_unmapped(path: Path) -> NoReturn:
    """Raise ForeignLog: a foreign bag needs a mapping; one is named or proposed."""
    bags = read_messages(path, set())
    topics = {name: topic for bag in bags for name, topic in bag.topics.items()}
    for name in builtin_mappings():
        channels = load_mapping(name).channels.values()
        if all(channel.optional or channel.topic in topics for channel in channels):
            offer = f"{name} with --mapping, which fits"
            proposal = ""
            break
    else:
        offer = "a file with --mapping"
        proposal = _proposal(path, topics)
    listed = [f"{name} ({topic.type})" for name, topic in sorted(topics.items())]
    raise ForeignLog(
        f"{path}: a bag needs a mapping of its topics; give {offer}; its topics are"
        f" {', '.join(listed):.600}",
        proposal,
    )


def _proposal(path: Path, topics: Mapping[str, Topic]) -> str:
    """Return the text of a mapping file; empty without a guess."""
    kinds = {name: full_type(topic.type) for name, topic in topics.items()}
    ours = {*_MEASURED, *_COMMANDED, _JOINTS, _TRANSFORMS}
    wanted = {n for n, kind in kinds.items() if kind in ours or not _OF_ROS.match(kind)}
    bags: list[Bag] = []
    for most in _READ:
        try:
            bags = read_messages(path, wanted, most)
            break
        except LogError:  # messages too large
            continue
    found: list[Candidate] = []
    names = list(topics)
    for name in sorted(wanted):
        sent = [message for bag in bags for message in bag.messages.get(name, ())]
        some = sent[:: max(1, len(sent) // _SEEN)]
        found += _candidates(name, topics[name], some, names) if some else []
    types = list(kinds.values())
    refuse_other_machine(str(path), names, types, has_wheels=has_wheels(found))
    choice = choose(found)
    is_mapped = words_of(choice.groups.get(NAV_X, "")) & _LOCALIZERS
    lasting = ("reference: {by: map}   # its errors last: SLAM, AMCL, scan matching",)
    return text(choice.lines, *(lasting if is_mapped else ()))


def _candidates(
    name: str, topic: Topic, sent: list[tuple[int, bytes]], names: list[str]
) -> Iterator[Candidate]:
    """Yield what a topic may be, each with its line of a mapping file and its numbers.

    Fields that are read by their names are appended to `names`.
    """
    kind, words = full_type(topic.type), words_of(name)
    at = f"topic: {quoted(name)}, field: "
    messages: list[tuple[int, Any]] = []
    with contextlib.suppress(Exception):  # foreign bytes fail decoders in many ways
        decode = Decoder(name, topic).decode
        messages = [(stamp_ns, decode(data)) for stamp_ns, data in sent]

    # A pose derived from the wheels' speeds comes last: it shows none of their errors.
    is_truth = bool(words & TRUTH)
    is_odometry = not is_truth and bool(words & ODOMETRY or kind == _ODOMETRY)
    rank = 0 if is_truth else 1 + is_odometry
    guesses: list[tuple[str, str, str, str]] = []
    by_type = _COMMANDED if words & {*SENT, *_ALSO_SENT} else _MEASURED
    if kind in {*_MEASURED, *_COMMANDED, _TRANSFORMS}:
        why = f"by its type, {kind.split('/')[-1]}"
        known_fields = by_type.get(kind, {}) or _of_frames(messages)
        for field, signal in known_fields.items():
            written = line(signal, field, words, at + quoted(field))
            guesses.append((signal, field, written, why))
    else:
        fields = dict.fromkeys(f for _, message in messages for f in _numbers(message))
        known = sorted(fields, key=lambda field: not field.startswith("velocity"))
        full = [f"{name}.{field}" for field in known]
        names += full
        for field, long, meant in zip(known, full, meanings(full, ()), strict=True):
            for signal, written in lines(long, meant, at + quoted(field)):
                guesses.append((signal, field, written, "by its name"))
    for signal, field, written, why in guesses:
        read = Field(field)
        t_s = np.array([stamp_ns * 1e-9 for stamp_ns, _ in messages])
        values = np.array([read(message) for _, message in messages])
        of_axis = int(signal == GYRO and field[-1:] in ("x", "y"))
        seen = samples(t_s, values)
        if not len(seen.t):
            continue  # nothing was measured
        own = of_axis if signal in (GYRO, IMU_YAW) else rank
        # what belongs together: a topic, or one of its frames
        group = name + field.partition("]")[0] if kind == _TRANSFORMS else name
        yield Candidate(signal, written, group, own, why, seen)


def _of_frames(messages: Iterable[tuple[int, Any]]) -> dict[str, str]:
    """Return the signals of frames that move, as a measured pose does, and not by odometry."""
    places: dict[str, list[tuple[float, float]]] = {}
    for one in (one for _, m in messages for one in getattr(m, "transforms", ())):
        parent, child = one.header.frame_id, one.child_frame_id
        if not ODOMETRY & (words_of(parent) | words_of(child)):
            place = one.transform.translation
            places.setdefault(child, []).append((place.x, place.y))
    found: dict[str, str] = {}
    for frame, at in places.items():
        if np.ptp(at, axis=0).max() > _MOVES_M:
            of_one = _MEASURED["geometry_msgs/msg/TransformStamped"]
            found |= _below(f"transforms[{frame}]", of_one)
    return found


def _numbers(message: Any, place: str = "") -> Iterator[str]:
    """Yield the paths of the numbers in a message; for lists those of their elements."""
    for name, value in items_of(message):
        at = place + name
        if name in _BESIDE or name.startswith("__") or name.endswith("covariance"):
            continue
        if hasattr(value, "w"):
            yield f"{at}.yaw"
        elif isinstance(value, list | np.ndarray):
            if len(value) > _LONGEST:
                continue
            names = names_of(message, value) or range(len(value))
            for label, item in zip(names, value, strict=False):
                element = f"{at}[{label}]"
                if items_of(item):
                    yield from _numbers(item, f"{element}.")
                elif not isinstance(item, str):
                    yield element
        elif items_of(value):
            yield from _numbers(value, f"{at}.")
        elif isinstance(value, int | float):
            yield at
