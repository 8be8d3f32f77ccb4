"""The section ``ros2:``: the daemon as a node of the robot."""

import re
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BeforeValidator, Field, StringConstraints, model_validator

from hilserver.config.doors import DoorRule, Right, Ros2Grant
from hilserver.config.section import Driver, LinkSection, Section, need
from hilserver.errors import meant
from hilserver.ros.flavours import DESCRIPTION, EXTRAS, FLAVOURS, Published
from hilserver.ros.measured import IOTBOT, Kind
from hilserver.ros.types import Types

_NAME = r"(/|(/?[A-Za-z_][A-Za-z0-9_]*)(/[A-Za-z_][A-Za-z0-9_]*)*)?"
Namespace = Annotated[str, StringConstraints(pattern=rf"^{_NAME}$", max_length=200)]
TopicName = Annotated[
    str, StringConstraints(pattern=rf"^{_NAME}$", min_length=1, max_length=200)
]
Wheel = Literal["fl", "rl", "fr", "rr"]
LOOPBACK = ("lo", "127.0.0.1")
LAST_DOMAIN = 232
REAL_ROBOT = "ros2_measured"  # name of the link by which the real robot is heard


class Ros2Publish(Section):
    """Topics that are written on request only."""

    tf: bool = Field(False, description="/tf: odom to base_link, from wheel odometry")
    clock: bool = Field(
        False, description="/clock: simulated time; all stamps then use it"
    )
    odom: bool = Field(
        False, description="odom: position and twist from wheel odometry"
    )
    estimate: bool = Field(
        False,
        description="odometry/filtered: the estimate of the observer, with covariances",
    )
    pose_stamped: bool = Field(
        False, description="/poseStamped: the simulated navigation tag"
    )
    robot_description: bool = Field(
        False, description="robot_description: URDF, for RViz"
    )


_KEYS = {topic.topic.lstrip("/"): key for key, topic in EXTRAS.items()}


def _by_key(value: object) -> object:
    """Return what is asked for by its keys; a list, and names as in ROS (``/tf``), will do."""
    if isinstance(value, list) and all(isinstance(name, str) for name in value):
        value = dict.fromkeys(value, True)
    if not isinstance(value, dict):
        return value

    asked: dict[object, object] = {}
    for name, is_wanted in value.items():
        bare = str(name).lstrip("/")
        key = _KEYS.get(bare, bare)
        if key in asked:
            raise ValueError(f"names {name} twice: remove one of them")
        asked[key] = is_wanted
    return asked


FrameName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_./-]{1,100}$")]


class Ros2Measured(Section):
    """The real robot's topics, as `measured.*` beside the simulated one."""

    topics: dict[TopicName, Kind] = Field(
        dict(IOTBOT),
        min_length=1,
        max_length=20,
        description="Its topics, each with its type; ros2.measured: iotbot is short for these",
    )
    namespace: Namespace = Field(
        "", description="Of the real robot, for relative names"
    )
    frame: FrameName = Field(
        "map", description="Coordinate frame in which its poses count"
    )
    base_frame: FrameName = Field("base_link", description="The robot itself in /tf")
    joints: dict[str, Wheel] = Field(
        {},
        max_length=20,
        description="Wheel by joint, if its name does not say front left and so on",
    )
    stale_after_ms: float = Field(
        1000.0, ge=20, le=3_600_000, description="Values older than this are Uncertain"
    )

    @model_validator(mode="after")
    def _usable(self) -> Self:
        names = [self.full_name(name) for name in self.topics]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"topics names {name} twice: remove one of them")
        if self.frame.lstrip("/") == self.base_frame.lstrip("/"):
            raise ValueError(
                "frame and base_frame are the same: name the frame of the floor plan"
            )
        return self

    def full_name(self, name: str) -> str:
        """Return the absolute name of a topic."""
        return _absolute(name, self.namespace)


def _iotbot(value: object) -> object:
    return {} if value == "iotbot" else value


class Ros2Config(LinkSection):
    """ROS 2 over DDS, without a ROS installation (extra ros2)."""

    enabled: bool = Field(False, description="Take part in ROS 2")
    flavour: Literal["iotbot_shield", "eduard", "thesis_sil", "diff_drive"] = Field(
        "iotbot_shield",
        description="Which robot program to be: topics, services, rates, QoS",
    )
    rmw: Literal["fastrtps", "cyclonedds"] = Field(
        "fastrtps",
        description="Middleware of the host, which decides how services carry their identity",
    )
    domain: int | None = Field(
        None,
        ge=0,
        le=LAST_DOMAIN,
        description="DDS domain; null: ROS_DOMAIN_ID, else 0",
    )
    interface: str = Field(
        "lo",
        pattern=r"^[A-Za-z0-9_.:-]{1,64}$",
        description="Network interface, by name or address",
    )
    allow_insecure_network: bool = Field(
        False,
        description="Use an interface other than lo: everyone there may then command",
    )
    grants: tuple[Ros2Grant, ...] | None = Field(
        None,
        max_length=3,
        description="What everyone there may do: command, write measured.*, set parameters; null:"
        " as opcua.anonymous, so nothing once opcua.users are named, and parameters only on lo",
    )
    peers: tuple[
        Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.:-]{1,253}$")], ...
    ] = Field(
        (),
        max_length=50,
        description="Addresses to contact where there is no multicast",
    )
    namespace: Namespace = Field(
        "", description="For relative names; empty: the flavour's own"
    )
    topics: dict[str, TopicName] = Field(
        {}, description="Renames: the flavour's name: other name"
    )
    publish: Annotated[
        Ros2Publish,
        BeforeValidator(_by_key, json_schema_input_type=list[str] | Ros2Publish),
    ] = Field(
        default_factory=Ros2Publish,
        description="Further topics, by key or in a list by name: [/tf, odometry/filtered]",
    )
    measured: Annotated[
        Ros2Measured | None,
        BeforeValidator(
            _iotbot, json_schema_input_type=Literal["iotbot"] | Ros2Measured | None
        ),
    ] = Field(
        None,
        description="The real robot's topics, as measured.*; iotbot: those of EduArt's IOT Bot",
    )
    array_order: tuple[Wheel, Wheel, Wheel, Wheel] = Field(
        ("fl", "rl", "fr", "rr"),
        description="Wheels and range finders in the arrays of thesis_sil",
    )
    service_fields: dict[str, str] = Field(
        {},
        max_length=20,
        description="Different types of service fields, as SendLighting.command: int32",
    )
    stale_after_ms: float = Field(
        500.0, ge=20, le=3_600_000, description="Commands older than this are stale"
    )
    on_stale: Literal["device", "ramp", "zero", "hold"] | None = Field(
        None,
        description="What then happens: device: enable is withdrawn until the host sends it again;"
        " ramp: safe state until Reset; zero: it stops until the next command; hold: a command"
        " stands while its writer is alive, then as ramp; null: hold in thesis_sil, zero in"
        " diff_drive, else device",
    )
    reenable: Literal["service", "command"] | None = Field(
        None,
        description="What enables the drive again after silence under device: the flavour's service"
        " or button, or a fresh command after one at rest as well; null: command where there is"
        " no service (thesis_sil, diff_drive)",
    )

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if not self.enabled:
            return self
        need("cyclonedds", "ros2", "ROS 2 needs the library cyclonedds")
        if self.interface not in LOOPBACK and not self.allow_insecure_network:
            raise ValueError(
                f"interface '{self.interface}' is reachable from the network, where everyone may"
                f" then command: use lo, or set allow_insecure_network: true"
            )
        known = FLAVOURS[self.flavour].topics
        for name in self.topics:
            if name not in known:
                hint = meant(name, known, "its names are " + ", ".join(known))
                raise ValueError(
                    f"topics: flavour {self.flavour} has no topic '{name}'; {hint}"
                )
        if self.reenable == "service" and not self._enabled_by:
            raise ValueError(
                f"reenable: flavour {self.flavour} has no service that enables the drive: use"
                " 'command'"
            )
        if len(set(self.array_order)) != len(self.array_order):
            raise ValueError("array_order names a wheel twice")
        self._keep_the_robots_apart()
        try:
            Types(self.service_fields)
        except ValueError as error:
            raise ValueError(f"service_fields: {error}") from None
        return self

    def _keep_the_robots_apart(self) -> None:
        """Raise if the real robot's topics are also topics of the simulated one."""
        if self.measured is None:
            return
        theirs = {self.measured.full_name(name): name for name in self.measured.topics}
        written = [topic.topic for topic in (*self.published, DESCRIPTION)]
        if not self.publish.robot_description:
            written.remove(DESCRIPTION.topic)
        read = [topic.topic for topic in FLAVOURS[self.flavour].subscribed]
        for does, names in (("publishes", written), ("is driven by", read)):
            both = [name for name in names if self.full_name(name) in theirs]
            if not both:
                continue
            name = both[0]
            full = self.full_name(both[0])
            is_moved = name in self.topics or name.startswith("/")
            if is_moved:
                way = f"ros2.topics: {{{name}: /sim{full}}}"
            else:
                way = "ros2.namespace: /sim"
            if not theirs[full].startswith("/"):
                way += ", or ros2.measured.namespace to that of the real robot"
            raise ValueError(
                f"measured: the simulated robot {does} {full} as well, so one would pass for the"
                f" other: set {way}"
            )

    @property
    def published(self) -> list[Published]:
        """What the simulated robot writes over and over."""
        flavour = FLAVOURS[self.flavour]
        asked = self.publish.model_dump()
        extras = [topic for name, topic in flavour.extras.items() if asked[name]]
        return list(dict.fromkeys((*flavour.published, *extras)))

    @property
    def driver(self) -> Driver:
        """The host."""
        limit_ms = self.stale_after_ms
        lapse = "ramp" if self.action == "hold" else ""
        who = ("ros2", "ros2", "the ROS 2 host")
        return Driver(*who, limit_ms, self.action, self.enabled, lapse=lapse)

    @property
    def action(self) -> str:
        """What happens to a command that is not renewed: device, ramp, zero or hold."""
        return self.on_stale or FLAVOURS[self.flavour].on_stale

    @property
    def command_enables(self) -> bool:
        """Whether a command alone ends what silence has done."""
        return (
            self.reenable or ("command" if not self._enabled_by else "service")
        ) == "command"

    @property
    def _enabled_by(self) -> str:
        return FLAVOURS[self.flavour].enabled_by

    def about(self, _folder: Path) -> str:
        """Return the robot program, the interface and the middleware."""
        how = f"{self.flavour} on {self.interface}, services as in {self.rmw}"
        if self.measured is not None:
            names = sorted(map(self.measured.full_name, self.measured.topics))
            how += f", the real robot by {', '.join(names)}"
        return how if self.enabled else ""

    @property
    def door(self) -> DoorRule:
        """What other nodes may do."""
        who = ("ROS 2", self.driver.source, "ros2.grants")
        usual = {Right.COMMAND}
        if self.interface in LOOPBACK:
            usual.add(Right.PARAMETERS)
        if self.measured is not None:
            usual.add(Right.MEASURED)
        return DoorRule(*who, self.enabled, frozenset(usual), self.grants)

    def full_name(self, name: str) -> str:
        """Return the absolute name of a topic or service, renamed, within the namespace."""
        space = self.namespace or FLAVOURS[self.flavour].namespace
        return _absolute(self.topics.get(name, name), space)


def _absolute(name: str, space: str) -> str:
    if name.startswith("/"):
        return name
    return re.sub("/+", "/", f"/{space}/{name}")
