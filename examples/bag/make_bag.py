"""Write the drive of drive.csv as a ROS 2 bag (MCAP) with topics of its own."""

import csv
import math
import sys
from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

TABLE = Path(__file__).parent / "drive.csv"
START_NS = 1_700_000_000_000_000_000
STORE = get_typestore(Stores.ROS2_HUMBLE)
TYPES = STORE.types
JOINTS, ODOMETRY, IMU = (
    "sensor_msgs/msg/JointState",
    "nav_msgs/msg/Odometry",
    "sensor_msgs/msg/Imu",
)


def header(stamp_ns: int) -> object:
    """Return a header of that time."""
    time = TYPES["builtin_interfaces/msg/Time"](
        sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9
    )
    return TYPES["std_msgs/msg/Header"](stamp=time, frame_id="robot")


def vector(x: float = 0.0, y: float = 0.0, z: float = 0.0) -> object:
    """Return a vector."""
    return TYPES["geometry_msgs/msg/Vector3"](x=x, y=y, z=z)


def heading(yaw_rad: float) -> object:
    """Return the quaternion of a heading."""
    z, w = math.sin(yaw_rad / 2), math.cos(yaw_rad / 2)
    return TYPES["geometry_msgs/msg/Quaternion"](x=0.0, y=0.0, z=z, w=w)


def joints(stamp_ns: int, left: str, right: str) -> object:
    """Return the speeds of both sides [rad/s]; forward is positive on both."""
    none = np.array([])
    speeds = np.array([float(left), float(right)])
    return TYPES[JOINTS](
        header=header(stamp_ns),
        name=["left", "right"],
        position=none,
        velocity=speeds,
        effort=none,
    )


def imu(stamp_ns: int, gyro_z: str) -> object:
    """Return the turn rate; -1 says that orientation and acceleration are not measured."""
    unknown = np.array([-1.0, *[0.0] * 8])
    return TYPES[IMU](
        header=header(stamp_ns),
        orientation=heading(0.0),
        orientation_covariance=unknown,
        angular_velocity=vector(z=float(gyro_z)),
        angular_velocity_covariance=np.zeros(9),
        linear_acceleration=vector(),
        linear_acceleration_covariance=unknown,
    )


def odometry(stamp_ns: int, x_mm: str, y_mm: str, heading_deg: str) -> object:
    """Return the pose of the navigation."""
    point = TYPES["geometry_msgs/msg/Point"](
        x=float(x_mm) / 1e3, y=float(y_mm) / 1e3, z=0.0
    )
    yaw_rad = math.radians(float(heading_deg))
    pose = TYPES["geometry_msgs/msg/Pose"](position=point, orientation=heading(yaw_rad))
    twist = TYPES["geometry_msgs/msg/Twist"](linear=vector(), angular=vector())
    return TYPES[ODOMETRY](
        header=header(stamp_ns),
        child_frame_id="robot",
        pose=TYPES["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose, covariance=np.zeros(36)
        ),
        twist=TYPES["geometry_msgs/msg/TwistWithCovariance"](
            twist=twist, covariance=np.zeros(36)
        ),
    )


def main(folder: Path) -> None:
    """Write every row of the table as messages; a pose only where the row has one."""
    topics = {
        "/command": JOINTS,
        "/wheels": JOINTS,
        "/imu": IMU,
        "/navigation": ODOMETRY,
    }
    with (
        TABLE.open(encoding="utf-8") as table,
        Writer(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer,
    ):
        link = {
            t: writer.add_connection(t, kind, typestore=STORE)
            for t, kind in topics.items()
        }
        for row in csv.DictReader(table):
            stamp_ns = START_NS + int(row["stamp_ms"]) * 1_000_000
            messages = {
                "/command": joints(stamp_ns, row["cmd_left"], row["cmd_right"]),
                "/wheels": joints(stamp_ns, row["w_left"], row["w_right"]),
                "/imu": imu(stamp_ns, row["gyro_z"]),
            }
            if row["x_mm"]:
                pose = (row["x_mm"], row["y_mm"], row["heading_deg"])
                messages["/navigation"] = odometry(stamp_ns, *pose)
            for topic, message in messages.items():
                writer.write(
                    link[topic], stamp_ns, STORE.serialize_cdr(message, topics[topic])
                )


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "drive"))
