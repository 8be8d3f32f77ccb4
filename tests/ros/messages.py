"""Messages of a real robot, made field by field."""

import math

import numpy as np

from hilserver.ros.types import known_types

MAKE = known_types().make


def header(frame="map", at_ns=0):
    sec, nanosec = divmod(at_ns, 10**9)
    stamp = MAKE("builtin_interfaces/msg/Time", sec=sec, nanosec=nanosec)
    return MAKE("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def vector(x=0.0, y=0.0, z=0.0):
    return MAKE("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def turned(yaw, norm=1.0):
    z, w = norm * math.sin(yaw / 2.0), norm * math.cos(yaw / 2.0)
    return MAKE("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, z=z, w=w)


def pose(x, y, yaw, norm=1.0):
    point = MAKE("geometry_msgs/msg/Point", x=x, y=y, z=0.3)
    return MAKE("geometry_msgs/msg/Pose", position=point, orientation=turned(yaw, norm))


def tagged(x, y, yaw, frame="map"):
    return MAKE(
        "geometry_msgs/msg/PoseStamped", header=header(frame), pose=pose(x, y, yaw)
    )


def floats(*numbers):
    layout = MAKE("std_msgs/msg/MultiArrayLayout", dim=[], data_offset=0)
    data = np.array(numbers, dtype=np.float32)
    return MAKE("std_msgs/msg/Float32MultiArray", layout=layout, data=data)


def joints(**speeds):
    return MAKE(
        "sensor_msgs/msg/JointState",
        header=header(""),
        name=list(speeds),
        position=np.zeros(0),
        velocity=np.array(list(speeds.values())),
        effort=np.zeros(0),
    )


def imu(*, orientation=None, unmeasured=()):
    def covariance(name):
        matrix = np.zeros(9)
        matrix[0] = -1.0 if name in unmeasured else 0.0
        return matrix

    return MAKE(
        "sensor_msgs/msg/Imu",
        header=header("imu_link"),
        orientation=orientation or turned(0.5),
        orientation_covariance=covariance("orientation"),
        angular_velocity=vector(z=0.2),
        angular_velocity_covariance=covariance("rate"),
        linear_acceleration=vector(0.3, -0.4, 9.81),
        linear_acceleration_covariance=covariance("force"),
    )


def odometry(frame, x=1.0, y=2.0, yaw=0.5):
    moved = MAKE(
        "geometry_msgs/msg/Twist", linear=vector(0.3, 0.1), angular=vector(z=0.7)
    )
    place = pose(x, y, yaw)
    return MAKE(
        "nav_msgs/msg/Odometry",
        header=header(frame),
        child_frame_id="base_link",
        pose=MAKE(
            "geometry_msgs/msg/PoseWithCovariance", pose=place, covariance=np.zeros(36)
        ),
        twist=MAKE(
            "geometry_msgs/msg/TwistWithCovariance",
            twist=moved,
            covariance=np.zeros(36),
        ),
    )


def transforms(*links):
    """Message of links (parent, child, x, y, yaw)."""
    made = [
        MAKE(
            "geometry_msgs/msg/TransformStamped",
            header=header(parent, 7),
            child_frame_id=child,
            transform=MAKE(
                "geometry_msgs/msg/Transform",
                translation=vector(x, y),
                rotation=turned(yaw),
            ),
        )
        for parent, child, x, y, yaw in links
    ]
    return MAKE("tf2_msgs/msg/TFMessage", transforms=made)
