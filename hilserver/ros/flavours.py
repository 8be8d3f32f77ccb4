"""The topics and services of four robot programs, as data.

``iotbot_shield`` and ``eduard`` are EduArt's two stacks, ``thesis_sil`` the five topics of the
thesis, ``diff_drive`` those of a base that ``diff_drive_controller`` of ros2_control drives. A name
without a leading slash is relative to the namespace.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Final

from hilserver.ros import incoming, outgoing
from hilserver.ros.qos import DEFAULT, LATCHED, SENSOR_DATA, Qos
from hilserver.ros.robot import RosFrame

FAST_S, ODOMETRY_S, STATUS_S = 0.02, 0.1, 0.5
FLOATS: Final = "std_msgs/msg/Float32MultiArray"
EDU_RELIABLE, EDU_BEST_EFFORT = Qos(depth=2), Qos(reliable=False, depth=2)


@dataclass(frozen=True, slots=True)
class Published:
    """A topic that we write; `period_s` None: once, latched for late readers."""

    topic: str
    type: str
    make: Callable[[RosFrame], Iterator[Any]]
    period_s: float | None = FAST_S
    qos: Qos = DEFAULT


DESCRIPTION: Final = Published(
    "robot_description", "std_msgs/msg/String", lambda _: iter(()), None, LATCHED
)
"""The robot's model, on request; written once, when the node starts."""


@dataclass(frozen=True, slots=True)
class Subscribed:
    """A topic that the host writes.

    `commands`: its silence is judged. `made_from`: topics that its writer itself hears; once it
    writes, they command here no longer.
    """

    topic: str
    type: str
    take: Callable[[RosFrame, Any], incoming.Values]
    commands: bool = True
    qos: Qos = SENSOR_DATA
    made_from: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Served:
    """A service."""

    name: str
    type: str
    serve: Callable[[RosFrame, Any], incoming.Answer]


@dataclass(frozen=True)
class Flavour:
    """Interface of one robot program.

    `enabled_by` names the service that enables the drive; `on_stale` is what a silence of the host
    does there, if the configuration says nothing else.
    """

    published: tuple[Published, ...]
    subscribed: tuple[Subscribed, ...]
    served: tuple[Served, ...] = ()
    namespace: str = ""
    enabled_by: str = ""
    on_stale: str = "device"
    extras: Mapping[str, Published] = field(default_factory=lambda: EXTRAS)

    @property
    def topics(self) -> tuple[str, ...]:
        """Every name that can be renamed."""
        written = [topic.topic for topic in (*self.published, *self.extras.values())]
        read = [topic.topic for topic in self.subscribed]
        names = [
            *written,
            *read,
            DESCRIPTION.topic,
            *(service.name for service in self.served),
        ]
        return tuple(dict.fromkeys(names))


RPM: Final = "iotbot_interface/msg/RotationSpeed"
JOY: Final = "sensor_msgs/msg/Joy"
TWIST: Final = "geometry_msgs/msg/Twist"

EXTRAS: Final[Mapping[str, Published]] = {
    "tf": Published("/tf", "tf2_msgs/msg/TFMessage", outgoing.transforms),
    "odom": Published("odom", "nav_msgs/msg/Odometry", outgoing.odometry),
    "estimate": Published(
        "odometry/filtered", "nav_msgs/msg/Odometry", outgoing.estimate
    ),
    "pose_stamped": Published(
        "/poseStamped", "geometry_msgs/msg/PoseStamped", outgoing.pose_stamped
    ),
    # last: a timer that it starts finds what was measured at that time
    "clock": Published("/clock", "rosgraph_msgs/msg/Clock", outgoing.clock),
}
"""On request, in every flavour."""

_IOTBOT_SHIELD: Final = Flavour(
    enabled_by="iotbot/srv/send_enable",
    published=(
        Published("iotbot/rpm/return", RPM, outgoing.rpm_return),
        Published("iotbot/imu", "sensor_msgs/msg/Imu", outgoing.imu, qos=SENSOR_DATA),
        Published("iotbot/tof", FLOATS, outgoing.tof, qos=SENSOR_DATA),
        Published(
            "iotbot/battery",
            "iotbot_interface/msg/Battery",
            outgoing.battery,
            qos=SENSOR_DATA,
        ),
        Published(
            "iotbot/temperature",
            "std_msgs/msg/Float32",
            outgoing.temperature,
            qos=SENSOR_DATA,
        ),
    ),
    subscribed=(
        Subscribed(
            "iotbot/rpm",
            RPM,
            incoming.rpm,
            made_from=("cmd_vel", "joy_extended", "joy"),
        ),
        Subscribed("cmd_vel", TWIST, incoming.velocity),
        Subscribed("joy_extended", JOY, incoming.axes),
        Subscribed("joy", JOY, incoming.gamepad),
    ),
    served=(
        Served(
            "iotbot/srv/send_lighting",
            "iotbot_interface/srv/SendLighting",
            incoming.send_lighting,
        ),
        Served(
            "iotbot/srv/send_enable",
            "iotbot_interface/srv/SendEnable",
            incoming.send_enable,
        ),
        Served(
            "iotbot/srv/send_imu_calibration",
            "std_srvs/srv/Empty",
            incoming.send_imu_calibration,
        ),
        Served(
            "iotbot/srv/send_imu_mode",
            "iotbot_interface/srv/SendEnable",
            incoming.send_imu_mode,
        ),
    ),
)

_EDUARD: Final = Flavour(
    namespace="eduard",
    enabled_by="set_mode",
    published=(
        Published(
            "odometry",
            "nav_msgs/msg/Odometry",
            outgoing.odometry,
            ODOMETRY_S,
            EDU_RELIABLE,
        ),
        Published(
            "status_report",
            "edu_robot/msg/RobotStatusReport",
            outgoing.status_report,
            STATUS_S,
            EDU_BEST_EFFORT,
        ),
        Published(
            "robot_kinematic_description",
            "edu_robot/msg/RobotKinematicDescription",
            outgoing.kinematic_description,
            None,
            Qos(latched=True, depth=2),
        ),
        Published(
            "joint_states",
            "sensor_msgs/msg/JointState",
            outgoing.joint_states,
            ODOMETRY_S,
            Qos(
                depth=8
            ),  # four messages at a time, of which a depth of 2 would keep two
        ),
        Published("imu", "sensor_msgs/msg/Imu", outgoing.imu, ODOMETRY_S, SENSOR_DATA),
        *(
            Published(
                f"range/{name.replace('_', '/')}/range",
                "sensor_msgs/msg/Range",
                outgoing.range_of(place),
                ODOMETRY_S,
                SENSOR_DATA,
            )
            for place, name in outgoing.PLACES.items()
        ),
    ),
    subscribed=(
        Subscribed("cmd_vel", TWIST, incoming.when_remote, qos=EDU_BEST_EFFORT),
        Subscribed(
            "autonomous/cmd_vel", TWIST, incoming.when_autonomous, qos=EDU_BEST_EFFORT
        ),
        Subscribed(
            "set_motor_rpm",
            FLOATS,
            incoming.motor_rpm,
            qos=EDU_BEST_EFFORT,
            made_from=("cmd_vel", "autonomous/cmd_vel"),
        ),
        Subscribed(
            "set_lighting_color",
            "edu_robot/msg/SetLightingColor",
            incoming.lighting,
            commands=False,
            qos=EDU_BEST_EFFORT,
        ),
    ),
    served=(
        Served("set_mode", "edu_robot/srv/SetMode", incoming.set_mode),
        Served("reset_odometry", "std_srvs/srv/Trigger", incoming.reset_odometry),
    ),
)

_THESIS_SIL: Final = Flavour(
    on_stale="hold",  # its node writes once for a key press, and nothing in between
    published=(
        Published("rpm/return", FLOATS, outgoing.rpm_return_thesis),
        Published("position_and_orientation", FLOATS, outgoing.position),
        Published("distance_measurements", FLOATS, outgoing.tof_thesis),
    ),
    subscribed=(
        Subscribed("rpm", FLOATS, incoming.rpm_thesis),
        Subscribed(
            "lights_color", "std_msgs/msg/Int16", incoming.lights_color, commands=False
        ),
    ),
)

_DIFF_DRIVE: Final = Flavour(
    on_stale="zero",
    published=(
        EXTRAS["odom"],
        EXTRAS["tf"],
        Published("joint_states", "sensor_msgs/msg/JointState", outgoing.wheel_states),
        # reliably, as imu_sensor_broadcaster does: any subscriber may ask for it
        Published("imu", "sensor_msgs/msg/Imu", outgoing.imu),
    ),
    subscribed=(
        Subscribed("cmd_vel", TWIST, incoming.velocity),
        Subscribed("cmd_vel", "geometry_msgs/msg/TwistStamped", incoming.stamped),
    ),
)

FLAVOURS: Final[Mapping[str, Flavour]] = {
    "iotbot_shield": _IOTBOT_SHIELD,
    "eduard": _EDUARD,
    "thesis_sil": _THESIS_SIL,
    "diff_drive": _DIFF_DRIVE,
}
