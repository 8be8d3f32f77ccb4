"""The robot for other programs."""

from xml.etree import ElementTree

import mujoco
import pytest

from hilserver.body.export import robot_urdf
from hilserver.body.parameters import BodyParameters
from hilserver.commands import main
from hilserver.errors import EXIT_DONE
from hilserver.plant.parameters import RobotParameters


def written(tmp_path, form):
    path = tmp_path / "robot"
    assert main(["model", "--format", form, "-o", str(path)]) == EXIT_DONE
    return path.read_text(encoding="utf-8")


def test_mujoco_reads_the_mjcf_and_finds_four_wheels(tmp_path):
    model = mujoco.MjModel.from_xml_string(written(tmp_path, "mjcf"))
    assert (model.nu, model.njnt) == (4, 5)
    assert sum(model.body_mass) == pytest.approx(5.0, rel=1e-3)


def test_the_urdf_is_a_tree_of_four_wheels_on_one_base(tmp_path):
    robot = ElementTree.fromstring(written(tmp_path, "urdf"))
    links = {link.get("name") for link in robot.findall("link")}
    corners = [
        f"{end}_{side}" for end in ("front", "rear") for side in ("left", "right")
    ]
    finders = {f"range/{corner.replace('_', '/')}" for corner in corners}
    assert links == {"base_link", *(f"wheel_{corner}" for corner in corners), *finders}
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    turning = {
        name for name, joint in joints.items() if joint.get("type") == "continuous"
    }
    assert turning == {f"base_to_wheel_{corner}" for corner in corners}, (
        "as in /joint_states"
    )
    place = joints["base_to_wheel_front_left"].find("origin").get("xyz").split()
    assert [float(c) for c in place] == pytest.approx([0.125, 0.155, 0.025])


def test_names_can_have_a_prefix():
    body = BodyParameters(robot=RobotParameters())
    robot = ElementTree.fromstring(robot_urdf(body, "eduard/"))
    names = {part.get("name") for part in robot} | {
        c.get("link") for c in robot.iter("child")
    }
    assert names
    assert all(name.startswith("eduard/") for name in names)
