"""Wheels of a URDF: joints that turn about the y axis, with a cylinder or sphere each."""

from pathlib import Path
from typing import Any, Final, NamedTuple
from xml.etree import ElementTree as Xml

import numpy as np
from scipy.spatial.transform import Rotation

from hilserver.errors import ConfigError, reason
from hilserver.exchange.geometry import DriveGeometry
from hilserver.plant.parameters import RobotParameters
from hilserver.small_file import read_small

LARGEST_URDF: Final = 10_000_000
MOST_JOINTS: Final = 100  # joints from a wheel up to the base
ALONG_Y: Final = 0.95  # least share of the axis; wheels with camber are wheels
UPRIGHT: Final = 0.7  # least share of the axis about which castors swivel

Read = tuple[dict[str, Any], float | str, float]


class _RollingWheel(NamedTuple):
    x_m: float
    y_m: float
    radius_m: float


def is_xacro(path: Path) -> str:
    """Return what to do with a xacro file."""
    return f"{path}: is xacro, not yet a URDF; run 'xacro {path.name} > robot.urdf' and name that"


def read(path: Path) -> Read:
    """Return plant keys, K_om and the difference of the radii; ConfigError if there are none."""
    try:
        text = read_small(path, LARGEST_URDF).decode("utf-8")
        if "<!ENTITY" in text:  # a small file of them grows without end
            raise ConfigError(f"{path}: defines entities; a URDF has none")
        root = Xml.fromstring(text)  # noqa: S314 - without entities it is what it seems
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {reason(error)}") from None
    except (UnicodeDecodeError, Xml.ParseError) as error:
        raise ConfigError(f"{path}: is no XML: {error}; name a URDF") from None
    if "ros.org/wiki/xacro" in text and ("${" in text or "xacro:" in text):
        raise ConfigError(is_xacro(path))
    if root.tag != "robot":
        raise ConfigError(f"{path}: begins with <{root.tag}>, a URDF with <robot>")

    wheels = _wheels(path, root)
    left = [wheel for wheel in wheels if wheel.y_m > 0.0]
    right = [wheel for wheel in wheels if wheel.y_m < 0.0]
    if len(left) != len(right) or len(left) not in (1, 2):
        raise ConfigError(
            f"{path}: has {len(left)} wheels on the left and {len(right)} on the right; one or two"
            " on each side can be simulated: write plant: in config.yaml"
        )

    left_m = sum(w.radius_m for w in left) / len(left)
    right_m = sum(w.radius_m for w in right) / len(right)
    x_m = [wheel.x_m for wheel in wheels]
    left_y_m = sum(w.y_m for w in left) / len(left)
    right_y_m = sum(w.y_m for w in right) / len(right)
    wheelbase_m = max(x_m) - min(x_m) if len(left) == 2 else None
    plant: dict[str, Any] = {
        "wheel_radius_m": (left_m + right_m) / 2.0,
        "track_m": left_y_m - right_y_m,
        "wheelbase_m": wheelbase_m,
        "icr_offset_m": 0.0,
    }
    # no element of a URDF says that wheels have rollers, but names and meshes do
    names = " ".join(value for node in root.iter() for value in node.attrib.values())
    if len(left) == 2 and "mecanum" in names.lower():
        plant["drive"] = "mecanum"
    gain = "geometric_diff" if len(left) == 1 else "geometric_skid"
    return plant, gain, 2.0 * (left_m - right_m) / (left_m + right_m)


def _wheels(path: Path, root: Xml.Element) -> list[_RollingWheel]:
    joints = {_link(joint, "child"): joint for joint in root.iter("joint")}
    links = {link.get("name"): link for link in root.iter("link")}
    wheels: list[_RollingWheel] = []
    without: list[str] = []
    for joint in root.iter("joint"):
        if "steer" in joint.get("name", "").lower():
            raise ConfigError(
                f"{path}: joint {joint.get('name')} says that this robot steers its wheels; only"
                " robots that turn by unequal speeds of their wheels can be read"
            )
    for child, joint in joints.items():
        if joint.get("type") != "continuous" or child not in links:
            continue
        place, axis, swivels = _pose(path, joint, joints)
        # castors swivel before they roll, and a lidar turns about z
        if swivels or abs(axis[1]) < ALONG_Y:
            continue
        radius_m = _radius_m(path, links[child])
        if radius_m is None:
            without.append(child)
        else:
            wheels.append(_RollingWheel(float(place[0]), float(place[1]), radius_m))
    if without:
        raise ConfigError(
            f"{path}: wheel {without[0]} has meshes only, which have no radius; give its"
            " <collision> a <cylinder>, or write plant: in config.yaml"
        )
    if not wheels:
        raise ConfigError(
            f"{path}: has no wheels: continuous joints that turn about the base's y axis; write"
            " plant: in config.yaml"
        )
    return wheels


def _link(joint: Xml.Element, which: str) -> str:
    node = joint.find(which)
    return "" if node is None else node.get("link", "")


def _vector(path: Path, text: str) -> Any:
    try:
        values = [float(word) for word in text.split()]
    except ValueError:
        values = []
    if len(values) != 3 or not np.isfinite(values).all():
        raise ConfigError(f"{path}: '{text:.60}' should be three numbers")
    return np.array(values)


def _pose(path: Path, joint: Xml.Element, joints: dict[str, Xml.Element]) -> Any:
    """Return place and axis of a joint in the base, and whether it swivels about an upright one."""
    chain = [joint]
    while (above := joints.get(_link(chain[0], "parent"))) is not None:
        chain.insert(0, above)
        if len(chain) > MOST_JOINTS:
            raise ConfigError(
                f"{path}: its joints form a circle; correct parent and child"
            )
    place = np.zeros(3)
    rotation = np.eye(3)
    swivels = False
    for one in chain:
        origin = one.find("origin")
        if origin is not None:
            angles = _vector(path, origin.get("rpy", "0 0 0"))
            place = place + rotation @ _vector(path, origin.get("xyz", "0 0 0"))
            rotation = rotation @ Rotation.from_euler("xyz", angles).as_matrix()
        node = one.find("axis")
        own = "1 0 0" if node is None else node.get("xyz", "1 0 0")
        axis = rotation @ _vector(path, own)
        axis = axis / max(float(np.linalg.norm(axis)), 1e-9)
        # a wheel's spring or rocker leaves it a wheel of the robot
        if one is not joint and one.get("type") in ("continuous", "revolute"):
            swivels = swivels or abs(axis[2]) > UPRIGHT
    return place, axis, swivels


def _radius_m(path: Path, link: Xml.Element) -> float | None:
    for where in ("collision", "visual"):
        for shape in ("cylinder", "sphere"):
            node = link.find(f"{where}/geometry/{shape}")
            if node is None:
                continue
            try:
                radius_m = float(node.get("radius", ""))
            except ValueError:
                radius_m = 0.0
            if radius_m > 0.0:
                return radius_m
            raise ConfigError(
                f"{path}: radius of {link.get('name')}: must be a number above 0"
            )
    return None


def urdf_text(robot: RobotParameters, geometry: DriveGeometry, comment: str) -> str:
    """Return a URDF of the wheels alone."""
    lines = ['<?xml version="1.0"?>', f"<!--\n{comment}-->", '<robot name="wheels">']
    lines.append('  <link name="base_link"/>')
    for name, x_m, y_m, radius_m in places(robot, geometry):
        lines += [
            f'  <link name="{name}">',
            f'    <collision><geometry><cylinder radius="{radius_m!r}" length="0.02"/></geometry>'
            '<origin rpy="1.5707963267948966 0 0"/></collision>',
            "  </link>",
            f'  <joint name="{name}_joint" type="continuous">',
            f'    <parent link="base_link"/><child link="{name}"/>',
            f'    <origin xyz="{x_m!r} {y_m!r} 0"/><axis xyz="0 1 0"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>", ""])


def sdf_text(robot: RobotParameters, geometry: DriveGeometry, comment: str) -> str:
    """Return an SDF model of the wheels alone, with Gazebo's controller as it was configured."""
    lines = ['<?xml version="1.0"?>', f"<!--\n{comment}-->", '<sdf version="1.9">']
    lines += ['  <model name="wheels">', '    <link name="base_link"/>']
    for name, x_m, y_m, radius_m in places(robot, geometry):
        lines += [
            f'    <link name="{name}">',
            f"      <pose>{x_m!r} {y_m!r} 0 -1.5707963267948966 0 0</pose>",
            f'      <collision name="{name}"><geometry><cylinder><radius>{radius_m!r}</radius>'
            "<length>0.02</length></cylinder></geometry></collision>",
            "    </link>",
            f'    <joint name="{name}_joint" type="revolute">',
            f"      <parent>base_link</parent><child>{name}</child>",
            "      <axis><xyz>0 0 1</xyz></axis>",
            "    </joint>",
        ]
    return "\n".join([*lines, "  </model>", "</sdf>", ""])


def places(
    robot: RobotParameters, geometry: DriveGeometry
) -> list[tuple[str, float, float, float]]:
    """Return name, x, y and radius of each wheel, all in m.

    Two wheels stand as far apart as they turn the robot; four scrub, and how far they turn it is
    the matter of their contact with the floor.
    """
    two = robot.wheelbase_m is None
    half_m = (geometry.separation_m if two else robot.track_m) / 2.0
    sides = (("left", half_m, geometry.left_m), ("right", -half_m, geometry.right_m))
    if robot.wheelbase_m is None:
        return [(f"{side}_wheel", 0.0, y_m, radius) for side, y_m, radius in sides]
    ends = (("front", robot.wheelbase_m / 2.0), ("rear", -robot.wheelbase_m / 2.0))
    return [
        (f"{end}_{side}_wheel", x_m, y_m, radius)
        for side, y_m, radius in sides
        for end, x_m in ends
    ]
