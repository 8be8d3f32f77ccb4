"""A robot from the files of others, and one sentence for files that describe none."""

import pytest

from hilserver.errors import ConfigError
from hilserver.exchange import read_robot
from tests.exchange.robots import (
    BURGER,
    FOUR_ROLLERS,
    HUSKY,
    OF_ITS_MAKER,
    TURTLEBOT,
    robot_of,
)


@pytest.fixture
def written(tmp_path):
    def write(name, text):
        (tmp_path / name).write_text(text)
        return tmp_path / name

    return write


def test_a_differential_drive_of_a_controllers_file(written):
    found = read_robot(written("controllers.yaml", TURTLEBOT))
    robot = robot_of(found)
    assert (robot.wheel_radius_m, robot.track_m, robot.wheelbase_m) == (
        0.033,
        0.16,
        None,
    )
    assert robot.k_om == pytest.approx(1.0 / (0.16 * 1.112))
    assert robot.max_linear_m_s == pytest.approx(0.5)


def test_dots_and_wildcards_of_ros_2_are_the_same_parameters(written):
    robot = robot_of(read_robot(written("husky.yaml", HUSKY)))
    assert robot.k_om == pytest.approx(1.0 / (0.5708 * 1.875))
    assert robot.max_linear_m_s == pytest.approx(1.0)


def test_wheels_of_a_urdf_stand_where_all_joints_up_to_the_base_put_them(written):
    found = read_robot(written("burger.urdf", BURGER))
    robot = robot_of(found)
    assert robot.wheel_radius_m == pytest.approx(0.033)
    assert robot.track_m == pytest.approx(0.16)
    assert robot.k_om == pytest.approx(1.0 / 0.16)


def test_radii_of_both_sides_may_differ(written):
    text = BURGER.replace('radius="0.033"', 'radius="0.034"', 1)
    found = read_robot(written("burger.urdf", text))
    assert found.plant["wheel_radius_m"] == pytest.approx(0.0335)
    assert found.wheel_radius_difference == pytest.approx(0.001 / 0.0335)


def test_what_the_mapping_says_differently_is_a_line(written):
    found = read_robot(written("controllers.yaml", TURTLEBOT))
    (line,) = found.against({"track_m": 0.17, "wheel_radius_m": 0.033})
    assert (
        line
        == "track_m is 0.17 in the mapping, which holds, and 0.16 in the robot's file"
    )


def test_the_makers_own_file_of_a_turtlebot3_is_read(written):
    """It has the same name twice; ROS 2 takes both."""
    robot = robot_of(read_robot(written("burger.yaml", OF_ITS_MAKER)))
    assert (robot.wheel_radius_m, robot.track_m) == (0.033, 0.16)


def test_a_mecanum_drive_of_a_controllers_file(written):
    robot = robot_of(read_robot(written("controllers.yaml", FOUR_ROLLERS)))
    assert robot.is_mecanum
    assert robot.wheel_radius_m == 0.05
    # om = (r - l)/(2 k), as its odometry has it
    assert robot.k_om == pytest.approx(1.0 / (2.0 * 0.4704))


@pytest.mark.parametrize(
    "limit",
    ["max_velocity: .NAN", "max_velocity: 0.0, has_velocity_limits: false", "{}"],
)
def test_a_limit_that_is_off_is_none(written, limit):
    limit = limit.replace("{}", "max_acceleration: 1")
    text = TURTLEBOT.replace("max_velocity: 0.5", limit)
    assert "max_rpm" not in read_robot(written("controllers.yaml", text)).plant


def test_a_robot_that_two_controllers_drive_alike_is_one(written):
    text = FOUR_ROLLERS.replace("/**:", "one:") + FOUR_ROLLERS.replace("/**:", "two:")
    assert robot_of(read_robot(written("controllers.yaml", text))).is_mecanum


def test_wheels_on_rockers_are_wheels_and_castors_are_none(written):
    rocker = BURGER.replace(
        '<joint name="left_joint"',
        """<link name="rocker"/><joint name="rocker_joint" type="revolute">
    <parent link="base_link"/><child link="rocker"/><origin xyz="0.1 0 0"/>
    <axis xyz="0 1 0"/></joint><joint name="left_joint\"""",
    ).replace(
        '<parent link="base_link"/><child link="left_wheel"/>',
        '<parent link="rocker"/><child link="left_wheel"/>',
    )
    assert robot_of(read_robot(written("a.urdf", rocker))).track_m == pytest.approx(
        0.16
    )
    castor = BURGER.replace(
        "</robot>",
        """<link name="fork"/><joint name="swivel" type="continuous">
    <parent link="base_link"/><child link="fork"/><axis xyz="0 0 1"/></joint>
  <link name="roll"><collision><geometry><sphere radius="0.01"/></geometry></collision></link>
  <joint name="castor" type="continuous"><parent link="fork"/><child link="roll"/>
    <origin xyz="-0.1 0.05 0"/><axis xyz="0 1 0"/></joint></robot>""",
    )
    assert robot_of(read_robot(written("b.urdf", castor))).wheelbase_m is None


def test_four_wheels_with_meshes_of_rollers_are_a_mecanum_drive(written):
    lines = ['<robot name="a"><link name="base_link"/>']
    for name, x, y in (("fl", 1, 1), ("rl", -1, 1), ("fr", 1, -1), ("rr", -1, -1)):
        lines.append(
            f'<link name="{name}"><visual><geometry><mesh filename="{{}}.stl"/></geometry>'
            '</visual><collision><geometry><cylinder radius="0.05" length="0.02"/></geometry>'
            f'</collision></link><joint name="{name}_joint" type="continuous">'
            f'<parent link="base_link"/><child link="{name}"/>'
            f'<origin xyz="{0.2 * x} {0.15 * y} 0"/><axis xyz="0 1 0"/></joint>'
        )
    text = "\n".join([*lines, "</robot>"])
    found = {
        mesh: robot_of(read_robot(written("a.urdf", text.replace("{}", mesh))))
        for mesh in ("Mecanum_wheel", "tyre")
    }
    assert [robot.is_mecanum for robot in found.values()] == [True, False]


def test_unequal_multipliers_are_read_and_a_line_says_what_becomes_of_them(written):
    text = TURTLEBOT.replace(
        "    wheel_separation_multiplier",
        "    left_wheel_radius_multiplier: 1.02\n"
        "    right_wheel_radius_multiplier: 1.0\n"
        "    wheel_separation_multiplier",
    )
    found = read_robot(written("controllers.yaml", text))
    assert found.plant["wheel_radius_m"] == pytest.approx(0.033 * 1.01)
    assert found.wheel_radius_difference == pytest.approx(0.02 / 1.01)
    (line,) = found.against({})
    assert "1.980% larger" in line
    assert "begins with equal wheels" in line


@pytest.mark.parametrize(
    ("name", "text", "says"),
    [
        ("a.yaml", "a: {ros__parameters: {wheelbase: 1.2}}", "no ros__parameters"),
        ("a.yaml", "diff: {wheel_separation: 0.1, wheel_radius: 0.1}", "ros__parameters"),
        ("a.yaml", TURTLEBOT.replace("0.033", "-1"), "must be a number above 0, not -1"),
        ("a.yaml", TURTLEBOT.replace("0.033", "$(arg r)"), "must be a number above 0"),
        ("a.yaml", TURTLEBOT.replace("wheel_separation:", "steering_names: [a]\n"
         "    wheel_separation:"), "steers"),
        ("a.yaml", TURTLEBOT.replace("diffdrive", "a") + HUSKY, "describes two robots"),
        ("a.yaml", FOUR_ROLLERS.replace("x: 0.0", "x: 0.1"), "base_frame_offset.x is 0.1"),
        ("a.yaml", TURTLEBOT.replace("0.033", "010:30"), "must be a number above 0"),
        ("a.yaml", "a: [" * 60 + "]" * 60, "nested more than"),
        ("a.yaml", "a: {b", "not YAML"),
        ("a.urdf", BURGER.replace("scan_joint", "Steering_joint"), "steers its wheels"),
        ("a.urdf", BURGER.replace("cylinder length", "mesh length"), "meshes only"),
        ("a.urdf", BURGER.replace("continuous", "fixed"), "has no wheels"),
        ("a.urdf", BURGER.replace("0.0 0.08 ", "0.0 a "), "should be three numbers"),
        ("a.urdf", BURGER.replace("base_footprint", "left_wheel"), "a circle"),
        ("a.urdf", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:a/></robot>',
         "run 'xacro a.urdf > robot.urdf'"),
        ("a.urdf", '<!DOCTYPE r [<!ENTITY a "b">]><robot>&a;</robot>', "entities"),
        ("a.urdf", "<sdf/>", "begins with <sdf>"),
        ("a.urdf", "no", "is no XML"),
        ("a.urdf.xacro", "<robot/>", "is xacro"),
        ("a.txt", "", "end its name in .yaml or .urdf"),
    ],
)  # fmt: skip
def test_a_file_that_describes_no_robot_is_one_sentence(written, name, text, says):
    path = written(name, text)
    with pytest.raises(ConfigError) as refused:
        read_robot(path)
    (line,) = str(refused.value).splitlines()
    assert line.startswith(str(path))
    assert says in line
