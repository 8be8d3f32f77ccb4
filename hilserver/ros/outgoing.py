"""From one frame to messages; each function makes the messages of one topic."""

import math
from collections.abc import Iterator, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.plant.layout import CORNERS, MODE_TWIST, MODE_WHEELS, WHEEL_WORDS
from hilserver.plant.units import RPM_PER_RAD_S, STANDARD_GRAVITY_M_S2
from hilserver.ros.robot import RosFrame

SHARE: Final = 0.02
"""Standard deviation of odometry per distance or angle: wheels on a level floor."""
LEAST_M, LEAST_RAD = 1e-3, 1e-3
UNKNOWN_VARIANCE: Final = 1e6
"""Variance of what the wheels do not measure, by the convention of ros2_control."""
_STATES: Final = ("x_m", "y_m", "yaw_rad", "linear_m_s", "angular_rad_s")
_DEVIATIONS: Final = tuple(f"{name}_sd" for name in _STATES)
_TOGETHER: Final = ("x_y_cov", "x_yaw_cov", "y_yaw_cov")
ROOM_DEGC: Final = 25.0  # in messages if no temperature is simulated
NO_TEMPERATURE_DEGC: Final = -273.0  # what the real node publishes while its IMU is raw
MODE_INACTIVE, MODE_REMOTE, MODE_AUTONOMOUS = 1, 2, 4
KINEMATIC_SKID, KINEMATIC_MECANUM = 1, 2
MOTORS: Final = ("rr", "fr", "rl", "fl")
"""edu_robot's order of motors; it also reverses all signs: right wheels forward positive."""
PLACES: Final = {place: WHEEL_WORDS[place].replace(" ", "_") for place in CORNERS}


def _floats(robot: RosFrame, numbers: list[float]) -> Any:
    layout = robot.make("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    data = np.array(numbers, dtype=np.float32)
    return robot.make("std_msgs/msg/Float32MultiArray", layout=layout, data=data)


def _rotation_speed(robot: RosFrame, quantity: str) -> Any:
    named = {
        f"{PLACES[wheel]}_rpm": robot[f"wheel.{wheel}.{quantity}"] for wheel in PLACES
    }
    return robot.make("iotbot_interface/msg/RotationSpeed", **named)


def rpm_return(robot: RosFrame) -> Iterator[Any]:
    """Measured speeds with the signs of the plant: right wheels are mirrored."""
    yield _rotation_speed(robot, "speed_rpm")


def rpm_target(robot: RosFrame) -> Iterator[Any]:
    """Set-points, for bags only: on the wire they come from the host.

    If a twist drives, nobody sends any; they are what the wheels are asked to do, as the motion
    node would have computed them.
    """
    by_twist = robot.get("control.mode", MODE_WHEELS) == MODE_TWIST
    by_twist &= "wheel.fl.demand_rpm" in robot.values
    yield _rotation_speed(robot, "demand_rpm" if by_twist else "setpoint_rpm")


def imu(robot: RosFrame) -> Iterator[Any]:
    """Rates and specific force in SI units; in the plane the orientation is a heading.

    Unmeasured values are NaN and marked as sensor_msgs/Imu requires; if all are unmeasured there
    is no message.
    """
    yaw, rate, force_x, force_y = (
        robot.get(f"imu.{name}", math.nan)
        for name in ("yaw_rad", "gyro_z_rad_s", "accel_x_m_s2", "accel_y_m_s2")
    )
    if all(map(math.isnan, (yaw, rate, force_x, force_y))):
        return
    heading = robot.turned(yaw)
    if robot.imu_is_raw:
        yaw = math.nan
        heading = robot.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=0.0, w=0.0)
    yield robot.make(
        "sensor_msgs/msg/Imu",
        header=robot.header("imu_link"),
        orientation=heading,
        orientation_covariance=_covariance(yaw),
        angular_velocity=robot.vector(z=rate),
        angular_velocity_covariance=_covariance(rate),
        linear_acceleration=robot.vector(force_x, force_y, STANDARD_GRAVITY_M_S2),
        linear_acceleration_covariance=_covariance(force_x, force_y),
    )


def _covariance(*values: float) -> Any:
    """Return zeros (accuracy unknown); if all values are missing, the first element is -1."""
    matrix = np.zeros(9)
    matrix[0] = -1.0 if all(map(math.isnan, values)) else 0.0
    return matrix


def tof(robot: RosFrame) -> Iterator[Any]:
    """Distances [m], fl, fr, rl, rr."""
    yield _floats(robot, [robot[f"tof.{place}_m"] for place in CORNERS])


def tof_thesis(robot: RosFrame) -> Iterator[Any]:
    """Distances [m], in the configured order."""
    yield _floats(robot, [robot[f"tof.{place}_m"] for place in robot.array_order])


def rpm_return_thesis(robot: RosFrame) -> Iterator[Any]:
    """Measured speeds [rpm] in the configured order, with the signs of the plant."""
    yield _floats(robot, robot.wheels("speed_rpm", robot.array_order))


def position(robot: RosFrame) -> Iterator[Any]:
    """Six floats: x, y, yaw of the planar model, then of the mechatronic one (NaN without it)."""
    names = ("x_m", "y_m", "yaw_rad")
    planar = [robot[f"pose.{name}"] for name in names]
    yield _floats(
        robot, planar + [robot.get(f"mech.{name}", math.nan) for name in names]
    )


def battery(robot: RosFrame) -> Iterator[Any]:
    """Voltage."""
    yield robot.make("iotbot_interface/msg/Battery", voltage=robot["battery.voltage_v"])


def temperature(robot: RosFrame) -> Iterator[Any]:
    """Temperature of the shield [degC]."""
    degc = robot.get("shield.temperature_degc", ROOM_DEGC)
    yield robot.make(
        "std_msgs/msg/Float32", data=NO_TEMPERATURE_DEGC if robot.imu_is_raw else degc
    )


def pose_stamped(robot: RosFrame) -> Iterator[Any]:
    """Pose measured by the simulated navigation tag."""
    pose = robot.pose(robot["nav.x_m"], robot["nav.y_m"], robot["nav.yaw_rad"])
    yield robot.make(
        "geometry_msgs/msg/PoseStamped", header=robot.header("map"), pose=pose
    )


def clock(robot: RosFrame) -> Iterator[Any]:
    """Time of the simulation."""
    yield robot.make("rosgraph_msgs/msg/Clock", clock=robot.time(robot.time_ns))


def transforms(robot: RosFrame) -> Iterator[Any]:
    """``odom`` to ``base_link``, from the wheels."""
    o = robot.odometer
    kind = "geometry_msgs/msg/Transform"
    place = robot.make(
        kind, translation=robot.vector(o.x_m, o.y_m), rotation=robot.turned(o.yaw_rad)
    )
    one = robot.make(
        "geometry_msgs/msg/TransformStamped",
        header=robot.header("odom"),
        child_frame_id=f"{robot.frame_prefix}base_link",
        transform=place,
    )
    yield robot.make("tf2_msgs/msg/TFMessage", transforms=[one])


def odometry(robot: RosFrame) -> Iterator[Any]:
    """Position and twist, from the wheels."""
    o, (ahead, aside, turning) = robot.odometer, robot.twist()
    place_m, heading_rad = SHARE * o.way_m + LEAST_M, SHARE * o.turned_rad + LEAST_RAD
    speed_m_s = SHARE * math.hypot(ahead, aside) + LEAST_M
    pose, twist = (o.x_m, o.y_m, o.yaw_rad), (ahead, aside, turning)
    motion = planar_covariance(
        speed_m_s**2, speed_m_s**2, (SHARE * abs(turning) + LEAST_RAD) ** 2
    )
    place = planar_covariance(place_m**2, place_m**2, heading_rad**2)
    yield planar_odometry(robot, "odom", pose, place, twist, motion)


def estimate(robot: RosFrame) -> Iterator[Any]:
    """Pose and twist of the observer, with their covariances, in ``map``; none before a fix."""
    if robot.get("estimate.state", 0.0) == 0.0:
        return
    e = {
        name: robot[f"estimate.{name}"] for name in (*_STATES, *_DEVIATIONS, *_TOGETHER)
    }
    place = planar_covariance(*(e[f"{name}_sd"] ** 2 for name in _STATES[:3]))
    for (i, j), name in zip(((0, 1), (0, 5), (1, 5)), _TOGETHER, strict=True):
        place[i, j] = place[j, i] = e[name]
    motion = planar_covariance(
        e["linear_m_s_sd"] ** 2, UNKNOWN_VARIANCE, e["angular_rad_s_sd"] ** 2
    )
    pose, twist = (
        (e["x_m"], e["y_m"], e["yaw_rad"]),
        (e["linear_m_s"], 0.0, e["angular_rad_s"]),
    )
    yield planar_odometry(robot, "map", pose, place, twist, motion)


def planar_covariance(ahead: float, aside: float, turn: float) -> NDArray[np.float64]:
    """Return the covariance of planar motion from its variances, shape (6, 6)."""
    return np.diag([ahead, aside, *[UNKNOWN_VARIANCE] * 3, turn])


def planar_odometry(
    robot: RosFrame,
    frame: str,
    pose: tuple[float, float, float],
    place: NDArray[np.float64],
    twist: tuple[float, float, float],
    motion: NDArray[np.float64],
) -> Any:
    """Return the message of a pose and a twist with their covariances."""
    ahead, aside, turning = twist
    moved = robot.make(
        "geometry_msgs/msg/Twist",
        linear=robot.vector(ahead, aside),
        angular=robot.vector(z=turning),
    )
    return robot.make(
        "nav_msgs/msg/Odometry",
        header=robot.header(frame),
        child_frame_id=f"{robot.frame_prefix}base_link",
        pose=robot.make(
            "geometry_msgs/msg/PoseWithCovariance",
            pose=robot.pose(*pose),
            covariance=place.ravel(),
        ),
        twist=robot.make(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=moved,
            covariance=motion.ravel(),
        ),
    )


# --- edu_robot ------------------------------------------------------------------------------------


def mode(robot: RosFrame) -> Any:
    """edu_robot's mode, which enables the drive."""
    driving = MODE_AUTONOMOUS if robot.autonomous else MODE_REMOTE
    return robot.make(
        "edu_robot/msg/Mode",
        mode=driving if robot["drive.enable"] else MODE_INACTIVE,
        drive_kinematic=KINEMATIC_MECANUM
        if robot.shape.max_lateral_m_s
        else KINEMATIC_SKID,
        feature_mode=0,
    )


def state(robot: RosFrame, words: str = "OK") -> Any:
    """edu_robot's state: always OK."""
    ok = robot.make("edu_robot/msg/State", value=0)
    return robot.make(
        "edu_robot/msg/RobotState", state=ok, mode=mode(robot), info_message=words
    )


def status_report(robot: RosFrame) -> Iterator[Any]:
    """Supply, speeds and mode."""
    volts = robot["battery.voltage_v"]
    rpm = [-speed for speed in robot.wheels("speed_rpm", MOTORS)]
    yield robot.make(
        "edu_robot/msg/RobotStatusReport",
        temperature=robot.get("shield.temperature_degc", ROOM_DEGC),
        mcu_voltage=volts,
        drive_voltage=volts,
        mcu_current=0.0,
        drive_current=robot.get("battery.current_a", 0.0),
        rpm=np.array(rpm, dtype=np.float32),
        robot_state=state(robot),
    )


def kinematic_description(robot: RosFrame) -> Iterator[Any]:
    """Wheel rates [rad/s] per vx, vy, omega, row-major; vy has no effect without rollers."""
    ahead = robot.shape.rpm_per_m_s / RPM_PER_RAD_S
    aside = ahead if robot.shape.max_lateral_m_s else 0.0
    turning = -robot.shape.rpm_per_rad_s / RPM_PER_RAD_S
    rows = [
        (
            ahead if wheel.endswith("r") else -ahead,
            aside if wheel.startswith("f") else -aside,
            turning,
        )
        for wheel in MOTORS
    ]
    matrix = robot.make(
        "edu_robot/msg/Matrix",
        cols=3,
        rows=4,
        data=np.array(rows, dtype=np.float32).ravel(),
    )
    limits = np.full(4, robot.shape.max_rpm, dtype=np.float32)
    yield robot.make(
        "edu_robot/msg/RobotKinematicDescription", k=matrix, wheel_limits=limits
    )


def joint_states(robot: RosFrame) -> Iterator[Any]:
    """One message per motor, as edu_robot sends them: all signs are reversed."""
    there = _joints(robot)
    for wheel in MOTORS:
        if wheel in there:
            yield _joint_state(robot, {wheel: -1.0})


def wheel_states(robot: RosFrame) -> Iterator[Any]:
    """All wheels in one message, forward positive (REP-103)."""
    forward = {wheel: 1.0 if wheel.endswith("l") else -1.0 for wheel in _joints(robot)}
    yield _joint_state(robot, forward)


def _joints(robot: RosFrame) -> dict[str, str]:
    """Return the joint of each wheel that exists, named as in the URDF."""
    is_on_one_axle = not robot.shape.wheelbase_m
    words = {"fl": "left", "fr": "right"} if is_on_one_axle else PLACES
    return {
        wheel: f"{robot.frame_prefix}base_to_wheel_{place}"
        for wheel, place in words.items()
    }


def _joint_state(robot: RosFrame, signs: Mapping[str, float]) -> Any:
    """Return the message of some wheels, each with the sign of its joint."""
    joints, stamp = _joints(robot), robot.time(robot.stamp_ns)
    angles_rad = [sign * robot[f"wheel.{w}.angle_rad"] for w, sign in signs.items()]
    speeds_rpm = [sign * robot[f"wheel.{w}.speed_rpm"] for w, sign in signs.items()]

    return robot.make(
        "sensor_msgs/msg/JointState",
        header=robot.make("std_msgs/msg/Header", stamp=stamp, frame_id=""),
        name=[joints[wheel] for wheel in signs],
        position=np.array(angles_rad),
        velocity=np.array(speeds_rpm) / RPM_PER_RAD_S,
        effort=np.zeros(0),
    )


def range_of(place: str) -> Any:
    """Return the function that makes the Range of one finder."""
    frame = f"range/{PLACES[place].replace('_', '/')}"

    def make(robot: RosFrame) -> Iterator[Any]:
        yield robot.make(
            "sensor_msgs/msg/Range",
            header=robot.header(frame),
            radiation_type=1,
            field_of_view=robot.shape.tof_field_rad,
            min_range=0.01,
            max_range=5.0,
            range=robot[f"tof.{place}_m"],
            variance=0.0,
        )

    return make
