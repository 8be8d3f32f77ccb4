"""The robot for other programs."""

from xml.etree import ElementTree

import mujoco
import pytest

from hilserver.body.export import robot_urdf
from hilserver.body.parameters import BodyParameters
from hilserver.commands import main
from hilserver.errors import EXIT_DONE
from hilserver.plant.parameters import RobotParameters

TURTLEBOT = """
plant:
  wheel_radius_m: 0.033
  wheelbase_m: null
  track_m: 0.16
  icr_offset_m: 0
  max_rpm: 65
mechatronic: {mass_kg: 1, centre_of_mass_m: [-0.03, 0, 0.05]}
"""


def written(tmp_path, form, text="{}"):
    path, config = tmp_path / "robot", tmp_path / "config.yaml"
    config.write_text(text, encoding="utf-8")
    asked = ["model", "-c", str(config), "--format", form, "-o", str(path)]
    assert main(asked) == EXIT_DONE
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
    own = {"base_link", "chassis", "imu_link"}
    assert links == {*own, *(f"wheel_{corner}" for corner in corners), *finders}
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    turning = {
        name for name, joint in joints.items() if joint.get("type") == "continuous"
    }
    assert turning == {f"base_to_wheel_{corner}" for corner in corners}, (
        "as in /joint_states"
    )
    place = joints["base_to_wheel_front_left"].find("origin").get("xyz").split()
    assert [float(c) for c in place] == pytest.approx([0.125, 0.155, 0.085])


def test_names_can_have_a_prefix():
    body = BodyParameters(robot=RobotParameters())
    robot = ElementTree.fromstring(robot_urdf(body, "eduard/"))
    names = {part.get("name") or part.get("reference") for part in robot} | {
        c.get("link") for c in robot.iter("child")
    }
    assert names
    assert all(name.startswith("eduard/") for name in names)


def test_a_robot_on_one_axle_has_two_wheels_and_castors(tmp_path):
    robot = ElementTree.fromstring(written(tmp_path, "urdf", TURTLEBOT))
    joints = {joint.get("name"): joint for joint in robot.findall("joint")}
    turning = {name for name, joint in joints.items() if joint.get("type") != "fixed"}
    assert turning == {"base_to_wheel_left", "base_to_wheel_right"}
    assert {"base_to_castor_front", "base_to_castor_rear"} < joints.keys()
    place = joints["base_to_wheel_left"].find("origin").get("xyz").split()
    assert [float(c) for c in place] == pytest.approx([0.03, 0.08, 0.033])


def test_a_description_needs_no_step_that_suits_its_tyres(tmp_path):
    """A Husky's would take shorter ones, and a plant of another period others."""
    husky = "plant: {wheel_radius_m: 0.165, track_m: 0.55, wheelbase_m: 0.512}"
    slow = "scheduler: {slices: {plant: 5}}"
    for text in (husky, slow):
        assert "base_to_wheel_front_left" in written(tmp_path, "urdf", text)


@pytest.mark.parametrize(
    ("text", "mass_kg", "driven"),
    [("{}", 5.0, 4), (TURTLEBOT, 1.0, 2), ("plant: {drive: mecanum}", 5.0, 4)],
    ids=["four_wheels", "two_wheels", "mecanum"],
)
def test_other_programs_can_drive_the_urdf(tmp_path, text, mass_kg, driven):
    """MuJoCo refuses a link that turns without inertia, and Gazebo drops it."""
    spec = mujoco.MjSpec.from_string(written(tmp_path, "urdf", text))
    spec.compiler.balanceinertia, spec.compiler.discardvisual = False, True
    spec.compiler.fusestatic = False
    spec.body("base_link").add_freejoint()
    floor = spec.worldbody.add_geom()
    floor.type, floor.size = mujoco.mjtGeom.mjGEOM_PLANE, [5, 5, 0.1]
    for name in ("castor_front", "castor_rear"):
        for geom in spec.body(name).geoms if spec.body(name) else ():
            geom.condim, geom.priority = 1, 1
    for joint in spec.joints[1:]:
        motor = spec.add_actuator(target=joint.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
        motor.set_to_velocity(kv=mass_kg * 0.01)
    model = spec.compile()
    assert (model.nu, sum(model.body_mass)) == (driven, pytest.approx(mass_kg))

    data = mujoco.MjData(model)
    data.ctrl[:] = 3.0
    while data.time < 3.0:
        mujoco.mj_step(model, data)
    x_m, y_m, z_m = data.qpos[:3]
    assert x_m > 0.1
    assert (y_m, z_m) == pytest.approx((0.0, 0.0), abs=0.02)


@pytest.mark.parametrize(
    ("text", "driven", "height_m", "radius_m"),
    [(TURTLEBOT, 2, 0.05, 0.033), ("plant: {drive: mecanum}", 4, 0.06, 0.05)],
    ids=["two_wheels", "mecanum"],
)
def test_the_robot_stands_and_drives_in_mujoco(
    tmp_path, text, driven, height_m, radius_m
):
    model = mujoco.MjModel.from_xml_string(written(tmp_path, "mjcf", text))
    assert (model.nu, model.njnt) == (driven, driven + 1)
    data = mujoco.MjData(model)
    data.ctrl[:] = 3.0
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    x_m, y_m, z_m = data.qpos[:3]
    assert 0.1 < x_m < 2 * 3.0 * radius_m
    assert abs(y_m) < 0.01
    assert z_m == pytest.approx(height_m, abs=0.003)


def test_wheels_in_each_other_s_place_are_refused_where_they_would_jam(
    tmp_path, capsys
):
    """The wheels of a Husky at the axles of an IOT Bot: the MJCF could not drive."""
    config = tmp_path / "config.yaml"
    config.write_text("plant: {wheel_radius_m: 0.165, track_m: 0.55}")
    says = "plant.wheelbase_m: 0.25 m is less than a wheel's diameter, 0.33 m, so front"
    assert main(["model", "-c", str(config), "--format", "mjcf"]) == 78
    assert says in capsys.readouterr().err
    assert main(["check", "-c", str(config)]) == EXIT_DONE
    assert says in "".join(capsys.readouterr())
