"""The robot for other programs: MJCF with wheels that turn, URDF for RViz and Foxglove."""

from xml.etree import ElementTree as Xml

from hilserver.body.parameters import PLATES_M, WHEEL_WIDTH_M, BodyParameters
from hilserver.plant.layout import WHEELS

_CHASSIS_Z_M = 0.5 * PLATES_M[2]


def _text(*numbers: float) -> str:
    return " ".join(f"{number:.9g}" for number in numbers)


def _chassis_m(body: BodyParameters) -> tuple[float, float, float]:
    """Return the middle of the plates, seen from the centre of mass."""
    ahead, aside, height = body.centre_of_mass_m
    return -ahead, -aside, body.robot.wheel_radius_m - height


def robot_mjcf(body: BodyParameters) -> str:
    """Return a robot with a hinge and a velocity servo per wheel.

    It needs the friction of MuJoCo's contacts, so it does not turn like `mjcf`'s, whose tyres are
    our own: it is for looking at, and for other work in MuJoCo.
    """
    root = Xml.Element("mujoco", model="hilserver robot")
    world = Xml.SubElement(root, "worldbody")
    Xml.SubElement(world, "light", pos="0 0 3", directional="true")
    Xml.SubElement(world, "geom", name="floor", type="plane", size="10 10 0.1")
    height = body.centre_of_mass_m[2]
    robot = Xml.SubElement(world, "body", name="robot", pos=_text(0.0, 0.0, height))
    Xml.SubElement(robot, "freejoint")
    inertia = _text(*body.moments_kg_m2)
    Xml.SubElement(robot, "inertial", pos="0 0 0", mass=_text(body.mass_kg), diaginertia=inertia)
    plates = _text(*(0.5 * size for size in PLATES_M))
    Xml.SubElement(robot, "geom", type="box", size=plates, pos=_text(*_chassis_m(body)))
    actuators = Xml.SubElement(root, "actuator")
    for name, centre in zip(WHEELS, body.wheels_m.tolist(), strict=True):
        wheel = Xml.SubElement(robot, "body", name=f"wheel_{name}", pos=_text(*centre))
        armature = _text(body.wheel_inertia_kg_m2)
        Xml.SubElement(wheel, "joint", name=f"wheel_{name}", axis="0 1 0", armature=armature)
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


def robot_urdf(body: BodyParameters) -> str:
    """Return links and joints of the robot; ``base_link`` is its centre of mass (REP-105)."""
    root = Xml.Element("robot", name="hilserver")
    base = Xml.SubElement(root, "link", name="base_link")
    visual = Xml.SubElement(base, "visual")
    Xml.SubElement(visual, "origin", xyz=_text(*_chassis_m(body)), rpy="0 0 0")
    Xml.SubElement(Xml.SubElement(visual, "geometry"), "box", size=_text(*PLATES_M))
    inertial = Xml.SubElement(base, "inertial")
    Xml.SubElement(inertial, "mass", value=_text(body.mass_kg))
    ixx, iyy, izz = (_text(moment) for moment in body.moments_kg_m2)
    Xml.SubElement(inertial, "inertia", ixx=ixx, iyy=iyy, izz=izz, ixy="0", ixz="0", iyz="0")
    for name, centre in zip(WHEELS, body.wheels_m.tolist(), strict=True):
        wheel = Xml.SubElement(Xml.SubElement(root, "link", name=f"wheel_{name}"), "visual")
        Xml.SubElement(wheel, "origin", xyz="0 0 0", rpy="1.57079633 0 0")
        radius, width = _text(body.robot.wheel_radius_m), _text(WHEEL_WIDTH_M)
        geometry = Xml.SubElement(wheel, "geometry")
        Xml.SubElement(geometry, "cylinder", radius=radius, length=width)
        joint = Xml.SubElement(root, "joint", name=f"wheel_{name}", type="continuous")
        Xml.SubElement(joint, "parent", link="base_link")
        Xml.SubElement(joint, "child", link=f"wheel_{name}")
        Xml.SubElement(joint, "origin", xyz=_text(*centre), rpy="0 0 0")
        Xml.SubElement(joint, "axis", xyz="0 1 0")
    return _document(root)


def _document(root: Xml.Element) -> str:
    Xml.indent(root)
    return Xml.tostring(root, encoding="unicode") + "\n"
