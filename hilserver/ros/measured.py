"""From messages of the real robot to what it measures; each function reads one type.

Signals are named without ``measured.``. A message that does not fit raises a ValueError with one
sentence; one that tells nothing, or not enough yet, gives an empty mapping.
"""

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any, Final, Literal, NamedTuple

from hilserver.plant.layout import WHEELS
from hilserver.plant.units import RPM_PER_RAD_S
from hilserver.ros.outgoing import MOTORS, PLACES
from hilserver.ros.robot import NS_PER_S

Values = dict[str, float]
Pose = tuple[float, float, float]

SPEEDS: Final = tuple(f"wheel.{wheel}.speed_rpm" for wheel in WHEELS)
TAG: Final = ("nav.x_m", "nav.y_m", "nav.yaw_rad")
POSE: Final = ("pose.x_m", "pose.y_m", "pose.yaw_rad")
TWIST: Final = ("velocity.linear_m_s", "velocity.lateral_m_s", "velocity.angular_rad_s")
INERTIAL: Final = (
    "imu.gyro_z_rad_s",
    "imu.yaw_rad",
    "imu.accel_x_m_s2",
    "imu.accel_y_m_s2",
)
MOST_FRAMES: Final = 200
NOT_MEASURED: Final = -1.0
"""First element of a covariance of sensor_msgs/Imu if the sensor does not measure the quantity."""
NOT_DRIVEN: Final = frozenset({"caster", "castor", "drop"})
"""Words in the names of joints of a base on one axle that turn no driven wheel."""
UNIT_NORM: Final = 0.1
"""A quaternion whose norm is further from 1 is no orientation."""


@dataclass
class Conventions:
    """How one robot's messages are to be read, and what of them waits for the rest."""

    array_signs: Mapping[str, float]  # by wheel, in the order of arrays without names
    joint_signs: Mapping[str, float]  # by wheel
    frame: str  # in which poses count
    base: str  # frame of the robot itself
    joints: Mapping[str, str] = field(default_factory=dict)  # wheel by name of a joint
    # each joint turns what are two wheels of the plant, front and rear
    is_on_one_axle: bool = False
    # why something was not taken
    remarks: dict[str, None] = field(default_factory=dict)
    # of joint states, until all four have come
    _wheels: Values = field(default_factory=dict)
    _tree: dict[str, tuple[str, Pose]] = field(default_factory=dict)  # parent by frame

    @classmethod
    def of(
        cls,
        flavour: str,
        array_order: tuple[str, ...],
        frame: str,
        base: str,
        joints: Mapping[str, str],
        *,
        is_on_one_axle: bool = False,
    ) -> "Conventions":
        """Return those of a robot program.

        edu_robot reverses all signs of the plant. Elsewhere arrays have the plant's signs, in which
        right wheels are mirrored, and joints turn forward with a positive sign (REP-103).
        """
        if flavour == "eduard":
            reversed_ = dict.fromkeys(MOTORS, -1.0)
            return cls(reversed_, reversed_, frame, base, joints, is_on_one_axle)
        forward = {wheel: 1.0 if wheel.endswith("l") else -1.0 for wheel in WHEELS}
        arrays = dict.fromkeys(array_order, 1.0)
        return cls(arrays, forward, frame, base, joints, is_on_one_axle)

    def counts(self, frame: str) -> bool:
        """Whether poses in a frame count; one without a name does."""
        name = frame.lstrip("/")
        if name in ("", self.frame):
            return True
        self.remark(
            f"gives poses in '{name:.60}', which is not ros2.measured.frame '{self.frame}'"
        )
        return False

    def remark(self, sentence: str) -> None:
        """Note why something was not taken, for whoever tells it."""
        self.remarks[sentence] = None

    def wheels_of(self, joint: str) -> list[str]:
        """Return the wheels that a joint turns, by its name; empty if it turns none."""
        words = set(re.split("[^a-z]+", joint.lower()))
        named = [self.joints[joint]] if joint in self.joints else []
        for wheel, place in PLACES.items():
            if wheel in words or words.issuperset(place.split("_")):
                named.append(wheel)
        if not self.is_on_one_axle:
            return named[:1]

        if joint not in self.joints and (self.joints or words & NOT_DRIVEN):
            return []  # who names joints names all
        sides = [wheel[-1] for wheel in named]
        if "wheel" in words:
            sides += [side[0] for side in ("left", "right") if side in words]
        return [f"f{sides[0]}", f"r{sides[0]}"] if sides else []

    def gather(self, speeds: Values) -> Values:
        """Keep speeds of single wheels; return those of all four once each has come again."""
        self._wheels |= speeds
        if len(self._wheels) < len(WHEELS):
            return {}
        whole, self._wheels = self._wheels, {}
        return whole

    def place(self, child: str, parent: str, pose: Pose) -> None:
        """Take the pose of a frame in its parent."""
        if child in self._tree or len(self._tree) < MOST_FRAMES:
            self._tree[child] = parent, pose

    def chain(self) -> list[str]:
        """Return the frames from `base` up to the one below `frame`; empty if they do not join."""
        names: list[str] = []
        name = self.base
        while name != self.frame:
            if name in names or name not in self._tree:
                way = f"leads from '{self.base}' to '{name:.60}'"
                self.remark(
                    f"{way}, not to ros2.measured.frame '{self.frame}'"
                    if names
                    else f"has no frame '{name}', which is ros2.measured.base_frame"
                )
                return []
            names.append(name)
            name = self._tree[name][0]
        return names

    def along(self, chain: list[str]) -> Pose:
        """Return the pose of the first frame of a chain in the parent of the last."""
        x, y, yaw = 0.0, 0.0, 0.0
        for name in chain:
            left, up, turn = self._tree[name][1]
            cos, sin = math.cos(turn), math.sin(turn)
            x, y, yaw = left + cos * x - sin * y, up + sin * x + cos * y, yaw + turn
        return x, y, math.remainder(yaw, math.tau)


def _yaw(q: Any) -> float:
    norm = math.sqrt(q.w**2 + q.x**2 + q.y**2 + q.z**2)
    if not abs(norm - 1.0) < UNIT_NORM:
        raise ValueError(
            f"its orientation is a quaternion of norm {norm:.3g} instead of 1"
        )
    return math.atan2(2.0 * (q.w * q.z + q.x * q.y), norm**2 - 2.0 * (q.y**2 + q.z**2))


def rotation_speed(how: Conventions, message: Any) -> Values:
    """RotationSpeed: speeds with the signs of the plant."""
    del how
    return {
        f"wheel.{w}.speed_rpm": float(getattr(message, f"{PLACES[w]}_rpm"))
        for w in WHEELS
    }


def array(how: Conventions, message: Any) -> Values:
    """Float32MultiArray: speeds [rpm] with the order and signs of the robot program."""
    numbers = [float(number) for number in message.data]
    if len(numbers) != len(how.array_signs):
        raise ValueError(
            f"{len(numbers)} numbers instead of one for each of four wheels"
        )
    pairs = zip(how.array_signs.items(), numbers, strict=True)
    return {
        f"wheel.{wheel}.speed_rpm": sign * number for (wheel, sign), number in pairs
    }


def joints(how: Conventions, message: Any) -> Values:
    """JointState: speeds, once all four wheels have come, in one message or in several."""
    if len(message.velocity) != len(message.name):
        raise ValueError(
            f"{len(message.velocity)} velocities for {len(message.name)} joints"
        )
    speeds: Values = {}
    for name, rad_s in zip(message.name, message.velocity, strict=True):
        for wheel in how.wheels_of(name):
            speeds[f"wheel.{wheel}.speed_rpm"] = (
                how.joint_signs[wheel] * rad_s * RPM_PER_RAD_S
            )
    if not speeds:
        named = ", ".join(message.name)
        how.remark(
            f"names no wheel ({named:.100}); ros2.measured.joints can say which is which"
        )
        return {}
    return how.gather(speeds)


def imu(how: Conventions, message: Any) -> Values:
    """Imu: turn rate, heading and specific force, as far as it measures them."""
    del how
    values: Values = {}
    if message.angular_velocity_covariance[0] != NOT_MEASURED:
        values["imu.gyro_z_rad_s"] = message.angular_velocity.z
    q = message.orientation
    has_heading = message.orientation_covariance[0] != NOT_MEASURED
    if has_heading and (q.x, q.y, q.z, q.w) != (
        0.0,
        0.0,
        0.0,
        0.0,
    ):  # as older drivers leave it
        values["imu.yaw_rad"] = _yaw(q)
    if message.linear_acceleration_covariance[0] != NOT_MEASURED:
        values["imu.accel_x_m_s2"] = message.linear_acceleration.x
        values["imu.accel_y_m_s2"] = message.linear_acceleration.y
    return values


def battery(how: Conventions, message: Any) -> Values:
    """Battery: its voltage."""
    del how
    return {"battery.voltage_v": float(message.voltage)}


def tag(how: Conventions, message: Any) -> Values:
    """PoseStamped: the navigation tag."""
    if not how.counts(message.header.frame_id):
        return {}
    at, q = message.pose.position, message.pose.orientation
    return dict(zip(TAG, (at.x, at.y, _yaw(q)), strict=True))


def odometry(how: Conventions, message: Any) -> Values:
    """Odometry: velocity, and the pose if it is in the frame that counts."""
    moving, pose = message.twist.twist, message.pose.pose
    twist = moving.linear.x, moving.linear.y, moving.angular.z
    values = dict(zip(TWIST, twist, strict=True))
    if how.counts(message.header.frame_id):
        at = pose.position.x, pose.position.y, _yaw(pose.orientation)
        values |= zip(POSE, at, strict=True)
    return values


def transforms(how: Conventions, message: Any) -> Values:
    """TFMessage: the pose of the robot in the frame that counts, along the frames between."""
    news = set()
    for one in message.transforms:
        at, q = one.transform.translation, one.transform.rotation
        child, parent = one.child_frame_id.lstrip("/"), one.header.frame_id.lstrip("/")
        how.place(child, parent, (at.x, at.y, _yaw(q)))
        news.add(child)
    chain = how.chain()
    if news.isdisjoint(chain):
        return {}
    return dict(zip(POSE, how.along(chain), strict=True))


class MeasuredType(NamedTuple):
    """What one type of message measures."""

    type: str
    signals: tuple[str, ...]
    read: Callable[[Conventions, Any], Values]
    is_shared: bool = False  # many nodes of one robot write the topic


Kind = Literal[
    "RotationSpeed",
    "Float32MultiArray",
    "JointState",
    "Imu",
    "Battery",
    "PoseStamped",
    "Odometry",
    "TFMessage",
]
"""Short name of a type, as the configuration has it."""

MEASURED_TYPES: Final[Mapping[Kind, MeasuredType]] = {
    "RotationSpeed": MeasuredType(
        "iotbot_interface/msg/RotationSpeed", SPEEDS, rotation_speed
    ),
    "Float32MultiArray": MeasuredType("std_msgs/msg/Float32MultiArray", SPEEDS, array),
    "JointState": MeasuredType("sensor_msgs/msg/JointState", SPEEDS, joints),
    "Imu": MeasuredType("sensor_msgs/msg/Imu", INERTIAL, imu),
    "Battery": MeasuredType(
        "iotbot_interface/msg/Battery", ("battery.voltage_v",), battery
    ),
    "PoseStamped": MeasuredType("geometry_msgs/msg/PoseStamped", TAG, tag),
    "Odometry": MeasuredType("nav_msgs/msg/Odometry", (*TWIST, *POSE), odometry),
    "TFMessage": MeasuredType(
        "tf2_msgs/msg/TFMessage", POSE, transforms, is_shared=True
    ),
}

IOTBOT: Final[Mapping[str, Kind]] = {
    "iotbot/rpm/return": "RotationSpeed",
    "iotbot/imu": "Imu",
    "iotbot/battery": "Battery",
    "poseStamped": "PoseStamped",
    "odom": "Odometry",
    "joint_states": "JointState",
    "/tf": "TFMessage",
}
"""Topics of EduArt's IOT Bot, with the tag of the thesis."""


def stamp_ns(message: Any) -> int:
    """Return when a message was measured, by its own stamp [ns]; 0 if it has none."""
    holders = getattr(message, "transforms", [message])
    stamps = [holder.header.stamp for holder in holders if hasattr(holder, "header")]
    return max((stamp.sec * NS_PER_S + stamp.nanosec for stamp in stamps), default=0)
