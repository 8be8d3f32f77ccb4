"""The robot for other programs."""

from xml.etree import ElementTree

import mujoco
import pytest

from hilserver.commands import main
from hilserver.errors import EXIT_DONE


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
    assert links == {"base_link", "wheel_fl", "wheel_rl", "wheel_fr", "wheel_rr"}
    places = {j.get("name"): j.find("origin").get("xyz").split() for j in robot.findall("joint")}
    assert [float(c) for c in places["wheel_fl"]] == pytest.approx([0.125, 0.155, 0.025])
