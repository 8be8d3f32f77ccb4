"""Message and service types: definitions, CDR and type hashes, by the package `rosbags`.

A ROS 2 node of Iron or newer announces the hash of its type (REP 2016); `rosbags` computes it from
the definition. A service is hashed as a message of three: request, response and event.
"""

from collections.abc import Mapping
from functools import cache
from typing import Any, Final

MESSAGES: Final[Mapping[str, str]] = {
    "iotbot_interface/msg/RotationSpeed": (
        "float32 front_left_rpm\nfloat32 front_right_rpm\n"
        "float32 rear_left_rpm\nfloat32 rear_right_rpm\n"
    ),
    "iotbot_interface/msg/Battery": "float32 voltage\n",
    "edu_robot/msg/Matrix": "int64 cols\nint64 rows\nfloat32[] data\n",
    "edu_robot/msg/Mode": "uint8 mode\nuint8 drive_kinematic\nuint8 feature_mode\n",
    "edu_robot/msg/State": "uint8 value\n",
    "edu_robot/msg/RobotKinematicDescription": "edu_robot/Matrix k\nfloat32[] wheel_limits\n",
    "edu_robot/msg/RobotState": (
        "edu_robot/State state\nedu_robot/Mode mode\nstring info_message\n"
    ),
    "edu_robot/msg/RobotStatusReport": (
        "float32 temperature\nfloat32 mcu_voltage\nfloat32 drive_voltage\nfloat32 mcu_current\n"
        "float32 drive_current\nfloat32[] rpm\nedu_robot/RobotState robot_state\n"
    ),
    "edu_robot/msg/SetLightingColor": (
        "string lighting_name\nuint8 r\nuint8 g\nuint8 b\nstd_msgs/Float32 brightness\nuint8 mode\n"
    ),
}
"""Types of EduArt, in no distribution (BSD-3; constants are left out as they are not hashed)."""

SERVICES: Final[Mapping[str, tuple[str, str]]] = {
    "iotbot_interface/srv/SendLighting": (
        "uint8 command\nuint8 red\nuint8 green\nuint8 blue\n",
        "bool sending_succesfull\n",
    ),
    "iotbot_interface/srv/SendEnable": ("bool enable\n", "bool sending_succesfull\n"),
    "edu_robot/srv/SetMode": (
        "edu_robot/Mode mode\nuint8 disable_feature\n",
        "edu_robot/RobotState state\n",
    ),
    "std_srvs/srv/Trigger": ("", "bool success\nstring message\n"),
    "std_srvs/srv/Empty": ("", ""),
    "rcl_interfaces/srv/GetParameters": (
        "string[] names\n",
        "rcl_interfaces/ParameterValue[] values\n",
    ),
    "rcl_interfaces/srv/GetParameterTypes": ("string[] names\n", "uint8[] types\n"),
    "rcl_interfaces/srv/SetParameters": (
        "rcl_interfaces/Parameter[] parameters\n",
        "rcl_interfaces/SetParametersResult[] results\n",
    ),
    "rcl_interfaces/srv/SetParametersAtomically": (
        "rcl_interfaces/Parameter[] parameters\n",
        "rcl_interfaces/SetParametersResult result\n",
    ),
    "rcl_interfaces/srv/ListParameters": (
        "string[] prefixes\nuint64 depth\n",
        "rcl_interfaces/ListParametersResult result\n",
    ),
    "rcl_interfaces/srv/DescribeParameters": (
        "string[] names\n",
        "rcl_interfaces/ParameterDescriptor[] descriptors\n",
    ),
}
"""Request and response. The widths of iotbot_interface are inferred from its source."""

WIDTHS: Final = (
    "bool",
    *(f"{sign}int{n}" for n in (8, 16, 32, 64) for sign in ("", "u")),
)
EVENT_INFO: Final = "service_msgs/msg/ServiceEventInfo"
GID: Final = "rmw_dds_common/msg/Gid"


class Types:
    """Every type that the daemon speaks.

    ValueError if a field of `widths` does not exist, or its type is invalid.

    Parameters
    ----------
    widths : mapping of str
        Different types for single fields of services: ``SendLighting.command: int32``.
    """

    def __init__(self, widths: Mapping[str, str] | None = None) -> None:
        from rosbags.typesys import Stores, get_typestore  # noqa: PLC0415 -- slow to import

        self.store: Any = get_typestore(Stores.ROS2_JAZZY)
        for name, text in MESSAGES.items():
            self.add(name, text)
        kinds: Any = _kinds()
        # a char is hashed as a uint8
        gid: Any = (kinds.ARRAY, ((kinds.BASE, ("uint8", 0)), 16))
        for holder, held in ((EVENT_INFO, "client_gid"), (GID, "data")):
            constants, fields = self.store.fielddefs[holder]
            fields = [(field, gid if field == held else kind) for field, kind in fields]
            self.store.fielddefs[holder] = constants, fields
        left = dict(widths or {})
        for field, width in left.items():
            if width not in WIDTHS:
                raise ValueError(f"{field}: '{width}' is none of {', '.join(WIDTHS)}")
        for name, (request, response) in SERVICES.items():
            self.add(f"{name}_Request", _widened(name, request, left))
            self.add(f"{name}_Response", _widened(name, response, left))
            self._add_service(name)
        if left:
            raise ValueError(f"no service has a field '{next(iter(left))}'")

    def add(self, name: str, text: str) -> None:
        """Add a message type, with the nested types of its definition.

        ValueError if the definition is invalid.
        """
        from rosbags.typesys import TypesysError, get_types_from_msg  # noqa: PLC0415 -- slow

        try:
            found = get_types_from_msg(text or "\n", name)
            if "/srv/" in name:  # which the package treats as messages
                found = {name: next(iter(found.values()))}
            self.store.register(found)
        except TypesysError as error:
            raise ValueError(f"{name}: {error}") from None

    def _add_service(self, name: str) -> None:
        kinds = _kinds()
        request, response, event = (
            f"{name}_{part}" for part in ("Request", "Response", "Event")
        )
        one_of = {
            part: (kinds.SEQUENCE, ((kinds.NAME, part), 1))
            for part in (request, response)
        }
        fields: list[tuple[str, Any]] = [("info", (kinds.NAME, EVENT_INFO))]
        fields += [("request", one_of[request]), ("response", one_of[response])]
        parts = {"request": request, "response": response, "event": event}
        whole = [
            (f"{part}_message", (kinds.NAME, full)) for part, full in parts.items()
        ]
        self.store.register({event: ([], fields)})
        self.store.register({name: ([], whole)})

    def fields(self, name: str) -> list[tuple[str, Any]]:
        """Return name and description of every field of a type."""
        fields: list[tuple[str, Any]] = self.store.fielddefs[name][1]
        return fields

    def hash(self, name: str) -> str:
        """Return ``RIHS01_...`` of a message or a whole service (``std_srvs/srv/Trigger``)."""
        return str(self.store.hash_rihs01(name))

    def prepare(self, name: str) -> None:
        """Generate the code for a type now, not with its first message."""
        self.store.get_msgdef(name)

    def make(self, name: str, /, **fields: Any) -> Any:
        """Return a message; nested ones are messages too, lists of numbers arrays."""
        return self.store.types[name](**fields)

    def encode(self, message: Any) -> bytes:
        """Return a message as CDR, little endian, with its header."""
        return bytes(self.store.serialize_cdr(message, message.__msgtype__))

    def decode(self, data: bytes, name: str) -> Any:
        """Return the message in `data`; ValueError if it is not one of this type."""
        from rosbags.serde import SerdeError  # noqa: PLC0415 -- slow to import

        try:
            return self.store.deserialize_cdr(data, name)
        except (SerdeError, ValueError, IndexError, TypeError, AssertionError) as error:
            raise ValueError(
                f"no message of type {name} ({type(error).__name__})"
            ) from None


def _kinds() -> Any:
    from rosbags.interfaces import Nodetype  # noqa: PLC0415 -- slow to import

    return Nodetype


def _widened(service: str, text: str, widths: dict[str, str]) -> str:
    """Return a definition with the field types of `widths`; used ones are removed from it."""
    short, lines = service.rpartition("/")[2], []
    for line in text.splitlines():
        kind, field = line.split()
        lines.append(f"{widths.pop(f'{short}.{field}', kind)} {field}\n")
    return "".join(lines)


@cache
def known_types() -> Types:
    """Return the default types."""
    return Types()
