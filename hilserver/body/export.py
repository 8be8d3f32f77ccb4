"""The robot as text: MJCF for our kernel, MJCF and URDF for other programs (RViz, Foxglove)."""

import math
from collections.abc import Iterable
from xml.etree import ElementTree as Xml

from hilserver.body.parameters import (
    BUMPER_GAP_M,
    GRAVITY_M_S2,
    PLATES_M,
    WHEEL_WIDTH_M,
    BodyParameters,
)
from hilserver.plant.hall import Solid
from hilserver.plant.layout import CORNERS, WHEEL_WORDS, WHEELS

_BODY = 'name="robot"'
SOFT = 'solref="0.02 1" solimp="0.9 0.95 0.001"'


def mjcf(body: BodyParameters, solids: Iterable[Solid] = ()) -> str:
    """Return the model that the kernel steps, with frictionless contacts, as the tyres are ours.

    Wheels are capsules, whose contact with an edge is exact. They touch only what carries them
    (contype 1); the bumper in front of them touches everything (contype 1 and 2).
    """
    ahead, aside, height = body.centre_of_mass_m
    bottom, top = (
        body.robot.wheel_radius_m / 2,
        max(2 * body.robot.wheel_radius_m, 0.15),
    )
    length = max(
        PLATES_M[0], (body.robot.wheelbase_m or 0.0) + 2 * body.robot.wheel_radius_m
    )
    width = max(PLATES_M[1], body.robot.track_m + WHEEL_WIDTH_M)
    bumper = _text(
        length / 2 + BUMPER_GAP_M, width / 2 + BUMPER_GAP_M, (top - bottom) / 2
    )
    middle = _text(-ahead, -aside, (top + bottom) / 2 - height)
    moments = " ".join(f"{moment:.17g}" for moment in body.moments_kg_m2)
    wheels = "\n".join(_wheel(name, body, i) for i, name in enumerate(WHEELS))
    contacts = "\n".join(
        f'    <contact geom1="wheel_{name}" num="1" data="force pos" reduce="netforce"/>'
        for name in WHEELS
    )
    return f"""<mujoco model="hilserver">
  <option timestep="{body.step_s:.17g}" gravity="0 0 -{GRAVITY_M_S2}" integrator="Euler">
    <flag autoreset="disable"/>
  </option>
  <size memory="4M"/>
  <default>
    <geom condim="1" contype="0" conaffinity="0" {SOFT}/>
  </default>
  <worldbody>
    <geom name="floor" type="plane" size="50 50 1" contype="1"/>
{_hall(solids)}
    <body {_BODY} pos="0 0 {height:.17g}">
      <freejoint/>
      <inertial pos="0 0 0" mass="{body.mass_kg:.17g}" diaginertia="{moments}"/>
      <site name="imu"/>
      <geom name="bumper" type="box" conaffinity="3" size="{bumper}" pos="{middle}"/>
{wheels}
    </body>
  </worldbody>
  <sensor>
{contacts}
    <contact geom1="bumper" num="1" data="found"/>
    <accelerometer site="imu"/>
  </sensor>
</mujoco>
"""


def _wheel(name: str, body: BodyParameters, i: int) -> str:
    place = " ".join(f"{c:.17g}" for c in body.wheels_m[i])
    radius, half = body.robot.wheel_radius_m, WHEEL_WIDTH_M / 2
    return (
        f'      <geom name="wheel_{name}" type="capsule" conaffinity="1" pos="{place}"'
        f' size="{radius:.17g} {half:.6g}" zaxis="0 1 0"/>'
    )


def _hall(solids: Iterable[Solid]) -> str:
    return "\n".join(
        f'    <geom name="hall_{i}" type="box" contype="{1 if s.carries else 2}"'
        f' size="{_text(*s.half_m)}" pos="{_text(*s.centre_m)}" xyaxes="{_axes(s)}"/>'
        for i, s in enumerate(solids)
    )


def _axes(solid: Solid) -> str:
    c, s, tilt = math.cos(solid.yaw_rad), math.sin(solid.yaw_rad), solid.pitch_rad
    along = (c * math.cos(tilt), s * math.cos(tilt), math.sin(tilt))
    return _text(*along, -s, c, 0.0)


FINDER_HEIGHT_M = 0.045  # EduArt's range finders above the floor
CLEARANCE = 0.25  # of the chassis above the floor at least, in wheel radii
WHEEL_SHARE = 0.005
"""Of the robot's mass, in a wheel or castor of the URDF: nothing states it, and all need one."""


def _text(*numbers: float) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def _chassis_m(body: BodyParameters) -> tuple[float, float, float]:
    """Return the middle of the plates relative to the centre of mass."""
    ahead, aside, height = body.centre_of_mass_m
    radius_m = body.robot.wheel_radius_m
    # on small wheels it would lie on the floor
    lowest_m = 0.5 * body.chassis_m[2] + CLEARANCE * radius_m
    return -ahead, -aside, max(radius_m, lowest_m) - height


def _wheels(body: BodyParameters) -> list[tuple[str, str, list[float]]]:
    """Return of each wheel its short name, its name in words and its centre.

    A robot on one axle has two, whose names say nothing of front and rear.
    """
    centres_m = dict(zip(WHEELS, body.wheels_m.tolist(), strict=True))
    if body.robot.wheelbase_m is None:
        return [("l", "left", centres_m["fl"]), ("r", "right", centres_m["fr"])]
    return [
        (wheel, WHEEL_WORDS[wheel].replace(" ", "_"), centre_m)
        for wheel, centre_m in centres_m.items()
    ]


def _castors(body: BodyParameters) -> dict[str, tuple[float, float, float]]:
    """Return the centres of the castors: balls, half as large as the wheels.

    One before and one behind the axle, so that it stands wherever its mass is.
    """
    if body.robot.wheelbase_m is not None:
        return {}
    ahead, aside, height = body.centre_of_mass_m
    reach_m, up_m = body.robot.track_m / 2, body.robot.wheel_radius_m / 2
    return {
        "castor_front": (reach_m - ahead, -aside, up_m - height),
        "castor_rear": (-reach_m - ahead, -aside, up_m - height),
    }


def robot_mjcf(body: BodyParameters) -> str:
    """Return a robot with a hinge and a velocity servo per wheel.

    A robot on one axle has two wheels, and castors without friction.

    It uses the friction of MuJoCo's contacts, so it does not turn like that of `mjcf`, which has
    our own tyres. It is meant for viewing, and for other work in MuJoCo.
    """
    root = Xml.Element("mujoco", model="hilserver robot")
    world = Xml.SubElement(root, "worldbody")
    Xml.SubElement(world, "light", pos="0 0 3", directional="true")
    Xml.SubElement(world, "geom", name="floor", type="plane", size="10 10 0.1")
    height = body.centre_of_mass_m[2]
    robot = Xml.SubElement(world, "body", name="robot", pos=_text(0.0, 0.0, height))
    Xml.SubElement(robot, "freejoint")
    inertia = _text(*body.moments_kg_m2)
    Xml.SubElement(
        robot, "inertial", pos="0 0 0", mass=_text(body.mass_kg), diaginertia=inertia
    )
    plates = _text(*(0.5 * size for size in body.chassis_m))
    Xml.SubElement(robot, "geom", type="box", size=plates, pos=_text(*_chassis_m(body)))
    for name, centre_m in _castors(body).items():
        ball = {"size": _text(body.robot.wheel_radius_m / 2), "pos": _text(*centre_m)}
        # its contact counts, not that of the floor, which has friction
        free = {"condim": "1", "priority": "1"}
        Xml.SubElement(robot, "geom", free, name=name, type="sphere", mass="0", **ball)
    actuators = Xml.SubElement(root, "actuator")
    for name, _, centre in _wheels(body):
        wheel = Xml.SubElement(robot, "body", name=f"wheel_{name}", pos=_text(*centre))
        armature = _text(body.wheel_inertia_kg_m2)
        Xml.SubElement(
            wheel, "joint", name=f"wheel_{name}", axis="0 1 0", armature=armature
        )
        size = _text(body.robot.wheel_radius_m, WHEEL_WIDTH_M / 2)
        Xml.SubElement(
            wheel,
            "geom",
            type="cylinder",
            size=size,
            zaxis="0 1 0",
            mass="0.001",
            rgba=".2 .2 .2 1",
        )
        Xml.SubElement(actuators, "velocity", joint=f"wheel_{name}", kv="5")
    return _document(root)


def robot_urdf(body: BodyParameters, prefix: str = "") -> str:
    """Return links and joints of the robot.

    ``base_link`` is the point of the floor below its centre of mass, as ``odom`` lies on the floor,
    too. It has no inertia, which the KDL of ROS does not support at the root; the chassis has.
    Joints and frames are named as in the ROS 2 messages, with `prefix` before each name.
    """
    root, base = Xml.Element("robot", name="hilserver"), f"{prefix}base_link"
    Xml.SubElement(root, "link", name=base)

    ahead, aside, height = body.centre_of_mass_m
    middle_m = 0.0, 0.0, height
    link = _fixed(root, base, f"{prefix}chassis", middle_m)
    _solid(link, "box", {"size": _text(*body.chassis_m)}, _chassis_m(body))
    rest = 1.0 - _add_wheels(root, body, prefix)
    _inertia(link, rest * body.mass_kg, [rest * one for one in body.moments_kg_m2])
    _fixed(root, base, f"{prefix}imu_link", middle_m)

    tof = body.robot.tof
    for place in CORNERS:
        name = WHEEL_WORDS[place].replace(" ", "/")
        is_front, is_left = place[0] == "f", place[1] == "l"
        x_m = tof.mount_x_m if is_front else -tof.mount_x_m
        y_m = tof.mount_y_m if is_left else -tof.mount_y_m
        at_m = x_m - ahead, y_m - aside, FINDER_HEIGHT_M
        yaw_rad = 0.0 if is_front else math.pi
        _fixed(root, base, f"{prefix}range/{name}", at_m, yaw_rad)
    return _document(root)


def _add_wheels(root: Xml.Element, body: BodyParameters, prefix: str) -> float:
    """Add wheels and castors; return their share of the mass."""
    wheels, castors = _wheels(body), _castors(body)
    base, height = f"{prefix}base_link", body.centre_of_mass_m[2]
    mass_kg, radius_m = WHEEL_SHARE * body.mass_kg, body.robot.wheel_radius_m
    size = {"radius": _text(radius_m), "length": _text(WHEEL_WIDTH_M)}
    rolling = 0.5 * mass_kg * radius_m**2
    across = 0.5 * rolling + mass_kg * WHEEL_WIDTH_M**2 / 12.0

    for _, words, (x_m, y_m, z_m) in wheels:
        name = f"wheel_{words}"
        link = Xml.SubElement(root, "link", name=prefix + name)
        _solid(link, "cylinder", size, rpy="1.57079633 0 0")
        _inertia(link, mass_kg, (across, rolling, across))
        joint = _joint(
            root, f"{prefix}base_to_{name}", "continuous", base, prefix + name
        )
        where = _text(x_m, y_m, z_m + height)
        Xml.SubElement(joint, "origin", xyz=where, rpy="0 0 0")
        Xml.SubElement(joint, "axis", xyz="0 1 0")

    for name, (x_m, y_m, z_m) in castors.items():
        link = _fixed(root, base, prefix + name, (x_m, y_m, z_m + height))
        _solid(link, "sphere", {"radius": _text(0.5 * radius_m)})
        _inertia(link, mass_kg, [0.4 * mass_kg * (0.5 * radius_m) ** 2] * 3)
        # they slide, which no other element of URDF says
        gazebo = Xml.SubElement(root, "gazebo", reference=prefix + name)
        Xml.SubElement(gazebo, "mu1").text = Xml.SubElement(gazebo, "mu2").text = "0"
    return WHEEL_SHARE * (len(wheels) + len(castors))


def _fixed(
    root: Xml.Element,
    base: str,
    name: str,
    at_m: tuple[float, float, float],
    yaw_rad: float = 0.0,
) -> Xml.Element:
    """Add a link at a fixed place; its joint has its name, with ``base_to_`` before it."""
    link = Xml.SubElement(root, "link", name=name)
    prefix = base.removesuffix("base_link")
    own = name.removeprefix(prefix).replace("/", "_")
    joint = _joint(root, f"{prefix}base_to_{own}", "fixed", base, name)
    Xml.SubElement(joint, "origin", xyz=_text(*at_m), rpy=f"0 0 {yaw_rad:.9g}")
    return link


def _solid(
    link: Xml.Element,
    shape: str,
    size: dict[str, str],
    at_m: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rpy: str = "0 0 0",
) -> None:
    """Give a link a shape that is seen, and that touches the floor and others."""
    for part in ("visual", "collision"):
        element = Xml.SubElement(link, part)
        Xml.SubElement(element, "origin", xyz=_text(*at_m), rpy=rpy)
        Xml.SubElement(Xml.SubElement(element, "geometry"), shape, size)


def _inertia(link: Xml.Element, mass_kg: float, moments: Iterable[float]) -> None:
    """Give a link its mass and moments about its axes; other programs drop one without."""
    inertial = Xml.SubElement(link, "inertial")
    Xml.SubElement(inertial, "mass", value=_text(mass_kg))
    ixx, iyy, izz = map(_text, moments)
    about = {"ixx": ixx, "iyy": iyy, "izz": izz, "ixy": "0", "ixz": "0", "iyz": "0"}
    Xml.SubElement(inertial, "inertia", about)


def _joint(
    root: Xml.Element, name: str, kind: str, parent: str, child: str
) -> Xml.Element:
    joint = Xml.SubElement(root, "joint", name=name, type=kind)
    Xml.SubElement(joint, "parent", link=parent)
    Xml.SubElement(joint, "child", link=child)
    return joint


def _document(root: Xml.Element) -> str:
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode") + "\n"
