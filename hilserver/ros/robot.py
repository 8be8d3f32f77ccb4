"""The robot for messages: one frame, its stamp, its dimensions."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Self

from hilserver.plant.layout import CORNERS, WHEELS, Parameters
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RPM_PER_RAD_S
from hilserver.ros.types import Types

NS_PER_S: Final = 1_000_000_000
_DIMENSIONS: Final = (
    "drive",
    "wheel_radius_m",
    "wheelbase_m",
    "track_m",
    "icr_offset_m",
    "max_rpm",
)


@dataclass(frozen=True, slots=True)
class Shape:
    """Dimensions, which do not change while the daemon runs."""

    # speed of a left wheel for a twist; right wheels are mirrored
    rpm_per_m_s: float
    rpm_per_rad_s: float
    max_rpm: float
    max_linear_m_s: float
    max_lateral_m_s: float  # 0 for a robot that cannot go sideways
    max_angular_rad_s: float
    wheel_radius_m: float
    wheelbase_m: float
    track_m: float
    tof_field_rad: float  # cone of a range finder
    # where the range finders sit, in the order fl, fr, rl, rr
    tof_x_m: tuple[float, ...] = ()
    tof_y_m: tuple[float, ...] = ()

    @classmethod
    def of(cls, robot: RobotParameters, packed: Parameters) -> Self:
        """Return the dimensions of a robot and of its packed parameters."""
        x_m, y_m = robot.tof.mount_x_m, robot.tof.mount_y_m
        return cls(
            rpm_per_m_s=packed.rpm_per_m_s,
            rpm_per_rad_s=packed.rpm_per_rad_s,
            max_rpm=robot.max_rpm,
            max_linear_m_s=robot.ranges.max_linear_m_s,
            max_lateral_m_s=robot.ranges.max_lateral_m_s,
            max_angular_rad_s=robot.ranges.max_angular_rad_s,
            wheel_radius_m=robot.wheel_radius_m,
            wheelbase_m=robot.wheelbase_m or 0.0,
            track_m=robot.track_m,
            tof_field_rad=robot.tof.field_of_view_rad,
            tof_x_m=(x_m, x_m, -x_m, -x_m),
            tof_y_m=(y_m, -y_m, y_m, -y_m),
        )

    @classmethod
    def described(cls, plant: Mapping[str, Any], kinematics: Mapping[str, Any]) -> Self:
        """Return the dimensions that sections of a configuration give.

        KeyError, TypeError or ValueError if they do not.
        """
        given = {key: plant[key] for key in _DIMENSIONS}
        robot = RobotParameters(**given, **kinematics)
        return cls.of(robot, pack(robot))


@dataclass
class Odometer:
    """Position from the wheels' angles, as a robot computes it.

    It assumes the nominal kinematics, so slip shows as a gap to the true pose. Each step uses the
    heading at its middle: exact on arcs, whatever the time between two frames.
    """

    shape: Shape
    x_m: float = 0.0
    y_m: float = 0.0
    yaw_rad: float = 0.0
    # total distance and angle, regardless of sign: errors grow with them
    way_m: float = 0.0
    turned_rad: float = 0.0
    _before: list[float] | None = None

    def reset(self) -> None:
        """Start again at zero, where the robot stands."""
        self.x_m = self.y_m = self.yaw_rad = self.way_m = self.turned_rad = 0.0

    def see(self, values: Mapping[str, float]) -> None:
        """Take the angles of a frame."""
        now = [values[f"wheel.{wheel}.angle_rad"] for wheel in WHEELS]
        before, self._before = self._before, now
        if (
            before is None
            or max(abs(a - b) for a, b in zip(now, before, strict=True)) > math.tau
        ):
            return  # the first frame, or a reset of the simulation
        turned = [(a - b) * RPM_PER_RAD_S for a, b in zip(now, before, strict=True)]
        ahead_m, aside_m, turn_rad = _motion(self.shape, turned)
        heading = self.yaw_rad + 0.5 * turn_rad
        self.x_m += ahead_m * math.cos(heading) - aside_m * math.sin(heading)
        self.y_m += ahead_m * math.sin(heading) + aside_m * math.cos(heading)
        self.way_m += math.hypot(ahead_m, aside_m)
        self.turned_rad += abs(turn_rad)
        self.yaw_rad = math.remainder(self.yaw_rad + turn_rad, math.tau)


def _motion(shape: Shape, rpm: Sequence[float]) -> tuple[float, float, float]:
    """Return the motion from wheels fl, rl, fr, rr [rpm]: ahead, left [m/s], turn [rad/s]."""
    fl, rl, fr, rr = rpm
    ahead = 0.25 * (fl + rl - fr - rr) / shape.rpm_per_m_s
    aside = (
        0.25 * (rl - fl + rr - fr) / shape.rpm_per_m_s if shape.max_lateral_m_s else 0.0
    )
    return ahead, aside, 0.25 * (fl + rl + fr + rr) / shape.rpm_per_rad_s


@dataclass
class RosFrame:
    """One frame, to be made into messages."""

    types: Types
    shape: Shape
    odometer: Odometer
    values: Mapping[str, float] = field(default_factory=dict)  # scalars by signal name
    stamp_ns: int = 0  # UTC, or simulated time if nodes follow ``/clock``
    time_ns: int = 0
    # order of wheels and range finders in arrays without names
    array_order: tuple[str, ...] = ("fl", "rl", "fr", "rr")
    frame_prefix: str = ""  # of the names of coordinate frames
    imu_is_raw: bool = False  # the host has requested the IMU without orientation
    autonomous: bool = False  # edu_robot's mode, which decides which topic drives
    buttons: list[int] = field(default_factory=list)  # of a gamepad, last state
    extended_axes: bool = False  # axes come by a topic of their own
    # commands that have no effect here, counted
    ignored: dict[str, int] = field(default_factory=dict)

    def __getitem__(self, name: str) -> float:
        return self.values[name]

    def get(self, name: str, default: float) -> float:
        """Return a signal that not every configuration has."""
        return self.values.get(name, default)

    def wheels(self, quantity: str, order: tuple[str, ...] = CORNERS) -> list[float]:
        """Return one quantity of all wheels."""
        return [self.values[f"wheel.{wheel}.{quantity}"] for wheel in order]

    def twist(self) -> tuple[float, float, float]:
        """Return the motion from the wheels' speeds: ahead, left [m/s], turn [rad/s]."""
        return _motion(self.shape, self.wheels("speed_rpm", WHEELS))

    def ignore(self, what: str) -> None:
        """Count a command that has no effect here."""
        self.ignored[what] = self.ignored.get(what, 0) + 1

    # --- parts of many messages -------------------------------------------------------------------

    def make(self, name: str, /, **fields: Any) -> Any:
        """Return a message of type ``package/msg/Name``."""
        return self.types.make(name, **fields)

    def time(self, ns: int) -> Any:
        """Return a ROS time."""
        sec, nanosec = divmod(ns, NS_PER_S)
        return self.make("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)

    def header(self, frame: str) -> Any:
        """Return a header with the stamp of this frame."""
        name = self.frame_prefix + frame
        return self.make(
            "std_msgs/msg/Header", stamp=self.time(self.stamp_ns), frame_id=name
        )

    def vector(self, x: float = 0.0, y: float = 0.0, z: float = 0.0) -> Any:
        """Return a Vector3."""
        return self.make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)

    def turned(self, yaw_rad: float) -> Any:
        """Return the quaternion of a heading."""
        half = 0.5 * yaw_rad
        kind = "geometry_msgs/msg/Quaternion"
        return self.make(kind, x=0.0, y=0.0, z=math.sin(half), w=math.cos(half))

    def pose(self, x: float, y: float, yaw: float) -> Any:
        """Return a planar Pose."""
        point = self.make("geometry_msgs/msg/Point", x=x, y=y, z=0.0)
        return self.make(
            "geometry_msgs/msg/Pose", position=point, orientation=self.turned(yaw)
        )
