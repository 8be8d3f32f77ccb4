"""Files that a diagnosis writes for other programs, judged by those programs' own equations."""

import csv
import io
import json
from dataclasses import replace
from math import tau
from xml.etree import ElementTree as Xml

import numpy as np
import pytest
import yaml

from hilserver.exchange import (
    FORMATS,
    WRITTEN,
    FoundTerm,
    RobotAnswer,
    files_for,
    read_robot,
)
from hilserver.exchange.geometry import DriveGeometry, patched
from hilserver.plant.parameters import RobotParameters
from tests.exchange.robots import (
    BURGER,
    DIFFERENTIAL,
    HUSKY,
    MECANUM,
    SKID,
    TURTLEBOT,
    robot_of,
)
from tests.plant.rig import Rig

RPM = 60.0 / tau
EQUAL = {"wheel_radius": 0.04, "rotation_gain": -0.3, "traction_slip": 0.05}
UNEQUAL = {"wheel_radius": -0.02, "wheel_radius_difference": 0.02}
TWISTS = ((0.2, 0.0), (0.0, 0.4), (0.12, -0.3))


@pytest.fixture(params=["differential", "skid", "turtlebot", "husky", "burger"])
def robot(request, tmp_path):
    made = {"differential": DIFFERENTIAL, "skid": SKID}
    if request.param in made:
        return made[request.param]
    texts = {"turtlebot": TURTLEBOT, "husky": HUSKY, "burger": BURGER}
    suffix = "urdf" if request.param == "burger" else "yaml"
    (tmp_path / f"own.{suffix}").write_text(texts[request.param])
    return robot_of(read_robot(tmp_path / f"own.{suffix}"))


def answer(robot, values, ci95=0.01, **more):
    terms = tuple(
        FoundTerm(name, value, (value - ci95, value + ci95), "named: " + name)
        for name, value in values.items()
    )
    return RobotAnswer(robot, terms, "0.1 .. 0.5 m/s; fitted to run.csv", **more)


def parameters(files, name):
    (node,) = yaml.safe_load(files[f"ros2_control/{name}"]).values()
    return node["ros__parameters"]


def rig(robot, terms=None):
    """The plant, with a limit that no drive of these tests reaches: then it is linear."""
    return Rig(
        **{
            name: getattr(robot, name)
            for name in ("drive", "wheel_radius_m", "wheelbase_m", "track_m", "icr_offset_m",
                         "rotation_gain")
        },
        max_rpm=1000.0,
        terms=terms or {},
    )  # fmt: skip


class DiffDrive:
    """diff_drive_controller, after its published equations."""

    def __init__(self, given):
        self.separation = (
            given["wheel_separation"] * given["wheel_separation_multiplier"]
        )
        self.left = given["wheel_radius"] * given["left_wheel_radius_multiplier"]
        self.right = given["wheel_radius"] * given["right_wheel_radius_multiplier"]

    def odometry(self, left_rad_s, right_rad_s):
        left, right = self.left * left_rad_s, self.right * right_rad_s
        return (left + right) / 2.0, (right - left) / self.separation

    def wheels(self, v, om):
        return (
            (v - om * self.separation / 2.0) / self.left,
            (v + om * self.separation / 2.0) / self.right,
        )


def driven(plant, left_rad_s, right_rad_s):
    rpm = left_rad_s * RPM, -right_rad_s * RPM
    return plant.rolling(*rpm).step(2000)


@pytest.mark.parametrize("terms", [EQUAL, EQUAL | UNEQUAL])
def test_the_real_robots_odometry_is_right(robot, terms):
    odometry = DiffDrive(
        parameters(
            files_for(answer(robot, terms), ("ros2_control",)), "real_robot.yaml"
        )
    )
    for left, right in ((3.0, 3.0), (-1.0, 2.5), (4.0, 1.5)):
        real = driven(rig(robot, terms), left, right)
        assert odometry.odometry(left, right) == pytest.approx(
            (real.velocity[0], real.velocity[2]), abs=1e-12
        )


@pytest.mark.parametrize("terms", [EQUAL, UNEQUAL])
def test_the_simulated_robot_moves_as_the_real_one(robot, terms):
    """The real robot has the controller of today, the simulated one that of the file."""
    files = files_for(answer(robot, terms), ("ros2_control",))
    today = files_for(answer(robot, {}), ("ros2_control",))
    now = DiffDrive(parameters(today, "real_robot.yaml"))
    simulator = DiffDrive(parameters(files, "simulator.yaml"))
    assert "hold all" in files["ros2_control/simulator.yaml"]
    for twist in TWISTS:
        real = driven(rig(robot, terms), *now.wheels(*twist))
        simulated = driven(rig(robot), *simulator.wheels(*twist))
        assert simulated.velocity == pytest.approx(real.velocity, abs=1e-9)
        assert simulated.pose == pytest.approx(real.pose, abs=1e-9)


def test_a_controller_with_unequal_radii_is_what_the_simulator_starts_from():
    """Its real robot has equal wheels: the simulated one must pull aside as that does."""
    configured = {"wheel_radius_difference": 0.02}
    found = answer(DIFFERENTIAL, {}, configured_difference=0.02)
    files = files_for(found, ("ros2_control",))
    for name in ("real_robot", "simulator"):
        assert "keep your two multipliers" in files[f"ros2_control/{name}.yaml"]
    today = files_for(answer(DIFFERENTIAL, configured), ("ros2_control",))
    now = DiffDrive(parameters(today, "real_robot.yaml"))
    simulator = DiffDrive(parameters(files, "simulator.yaml"))
    for twist in TWISTS:
        real = driven(rig(DIFFERENTIAL), *now.wheels(*twist))
        simulated = driven(rig(DIFFERENTIAL, configured), *simulator.wheels(*twist))
        assert simulated.velocity == pytest.approx(real.velocity, abs=1e-9)


def test_no_file_is_written_that_an_older_diagnosis_could_leave_behind():
    for robot in (DIFFERENTIAL, MECANUM):
        files = files_for(answer(robot, {}), tuple(FORMATS))
        assert set(files) == set(WRITTEN)


def test_the_gap_that_unequal_wheels_leave_is_printed(robot):
    terms = EQUAL | UNEQUAL
    files = files_for(answer(robot, terms), ("ros2_control",))
    text = files["ros2_control/simulator.yaml"]
    gap = float(text.partition("cannot copy: ")[2].split()[0])
    now = DiffDrive(
        parameters(files_for(answer(robot, {}), ("ros2_control",)), "real_robot.yaml")
    )
    simulator = DiffDrive(parameters(files, "simulator.yaml"))
    turn = (0.0, 0.5)
    real = driven(rig(robot, terms), *now.wheels(*turn)).velocity
    simulated = driven(rig(robot), *simulator.wheels(*turn)).velocity
    base_m = DriveGeometry.of(robot).separation_m
    # the same turn, and a small speed ahead that should not be there
    assert simulated[2] == pytest.approx(real[2], rel=gap**2 + 1e-3)
    assert abs(simulated[0] - real[0]) < 2.0 * gap * 0.5 * base_m
    assert 0.0 < gap < 0.01


def test_files_read_again_describe_the_patched_robot(robot, tmp_path):
    terms = EQUAL | UNEQUAL
    files = files_for(answer(robot, terms), tuple(FORMATS))
    (tmp_path / "real.yaml").write_text(files["ros2_control/real_robot.yaml"])
    (tmp_path / "wheels.urdf").write_text(files["urdf/wheels.urdf"])
    wanted = DriveGeometry.of(patched(robot, terms))
    names = ["real.yaml"]
    names += ["wheels.urdf"] if robot.wheelbase_m is None else []
    for name in names:
        found = read_robot(tmp_path / name)
        again = robot_of(found)
        difference = {"wheel_radius_difference": found.wheel_radius_difference}
        got = DriveGeometry.of(patched(again, difference))
        assert (got.left_m, got.right_m, got.separation_m) == pytest.approx(
            (wanted.left_m, wanted.right_m, wanted.separation_m), rel=1e-12
        )


def mecanum_twist(given, wheels):
    """mecanum_drive_controller's odometry; wheels fl, rl, rr, fr, forward positive."""
    fl, rl, rr, fr = wheels
    r = given["kinematics"]["wheels_radius"]
    k = given["kinematics"]["sum_of_robot_center_projection_on_X_Y_axis"]
    return (
        r * (fl + rl + rr + fr) / 4.0,
        r * (-fl + rl - rr + fr) / 4.0,
        r / k * (-fl - rl + rr + fr) / 4.0,
    )


def mecanum_wheels(given, vx, vy, om):
    """mecanum_drive_controller's command; wheels fl, rl, rr, fr, forward positive."""
    r = given["kinematics"]["wheels_radius"]
    turn = given["kinematics"]["sum_of_robot_center_projection_on_X_Y_axis"] * om
    return (
        np.array([vx - vy - turn, vx + vy - turn, vx - vy + turn, vx + vy + turn]) / r
    )


def rolled(plant, wheels):
    """The plant, whose wheels fl, rl, rr, fr turn with these speeds [rad/s], forward positive."""
    rpm = wheels[[0, 1, 3, 2]] * RPM * np.array([1, 1, -1, -1])
    plant.x.speed = plant.x.motor = rpm
    plant.x.integral = rpm / MECANUM.process.gain
    return plant.wheels(*rpm).step(1000)


@pytest.mark.parametrize(
    "terms",
    [{"wheel_radius": 0.04, "rotation_gain": -0.1}, {"rotation_gain": 0.2}],
)
def test_a_simulated_mecanum_drive_moves_as_the_real_one(terms):
    files = files_for(answer(MECANUM, terms), ("ros2_control",))
    today = files_for(answer(MECANUM, {}), ("ros2_control",))
    now, simulator = (
        parameters(today, "real_robot.yaml"), parameters(files, "simulator.yaml")
    )  # fmt: skip
    assert now != simulator
    for twist in (
        (0.2, 0.0, 0.0),
        (0.0, 0.15, 0.0),
        (0.1, -0.1, 0.5),
        (0.0, 0.0, -0.6),
    ):
        real = rolled(rig(MECANUM, terms), mecanum_wheels(now, *twist))
        simulated = rolled(rig(MECANUM), mecanum_wheels(simulator, *twist))
        assert np.abs(real.velocity).max() > 0.1
        assert simulated.velocity == pytest.approx(real.velocity, abs=1e-9)
        assert simulated.pose == pytest.approx(real.pose, abs=1e-9)


def test_mecanum_odometry_is_right_and_the_file_is_read_again(tmp_path):
    terms = {"wheel_radius": 0.04, "rotation_gain": -0.1}
    files = files_for(answer(MECANUM, terms), ("ros2_control",))
    given = parameters(files, "real_robot.yaml")
    said = files["ros2_control/real_robot.yaml"]
    assert "# wheels_radius 0.052 +- 0.0005 (95 %)" in said
    assert "wheel_separation" not in said
    wheels = np.array([2.0, 3.0, 1.0, 4.0])
    real = rolled(rig(MECANUM, terms), wheels)
    assert mecanum_twist(given, wheels) == pytest.approx(real.velocity, abs=1e-12)

    (tmp_path / "real.yaml").write_text(files["ros2_control/real_robot.yaml"])
    again = robot_of(read_robot(tmp_path / "real.yaml"))
    assert again.wheel_radius_m == pytest.approx(0.05 * 1.04, rel=1e-12)
    assert again.k_om == pytest.approx(MECANUM.k_om * 0.9, rel=1e-12)


def test_each_file_says_cause_interval_validity_and_what_it_cannot_hold():
    found = answer(DIFFERENTIAL, {"rotation_gain": 0.2, "longitudinal_slip": 0.1})
    files = files_for(found, tuple(FORMATS))
    comments = [text for name, text in files.items() if "parameters." not in name]
    for text in comments:
        assert "rotation_gain = 0.2 1 (95 %: 0.19 .. 0.21)" in text
        assert "Valid for 0.1 .. 0.5 m/s; fitted to run.csv" in text
        assert "no place for it: longitudinal_slip" in text
    for name in ("urdf/wheels.urdf", "sdf/wheels.sdf"):
        Xml.fromstring(files[name])


def test_the_interval_of_a_multiplier_follows_from_those_of_its_causes():
    found = answer(DIFFERENTIAL, {"rotation_gain": 0.25, "wheel_radius": 0.0})
    # (1/1.24 - 1/1.26)/2 = 0.0064
    assert (
        found.interval("a", lambda g: g.separation_m / 0.2) == "a 0.8 +- 0.0064 (95 %)"
    )
    assert found.interval("b", lambda g: g.left_m / 0.04) == "b 1 +- 0.01 (95 %)"


def test_a_number_that_nothing_was_found_about_has_no_interval():
    text = files_for(RobotAnswer(RobotParameters(), ()), ("ros2_control",))
    assert "+-" not in text["ros2_control/real_robot.yaml"]


def test_a_logs_name_ends_no_comment():
    named = replace(
        answer(DIFFERENTIAL, {"wheel_radius": 0.1}), valid="a---->\nrun.csv"
    )
    files = files_for(named, ("urdf", "ros2_control"))
    assert Xml.fromstring(files["urdf/wheels.urdf"]).tag == "robot"
    assert parameters(files, "real_robot.yaml")["wheel_radius"] == 0.04


def test_covariances_follow_from_the_noise_of_the_wheels():
    noise = {f"wheel.{w}.speed_rpm": 0.6 for w in ("fl", "rl", "fr", "rr")}
    found = answer(DIFFERENTIAL, {}, noise_sd=noise)
    text = files_for(found, ("ros2_control",))["ros2_control/real_robot.yaml"]
    diagonal = yaml.safe_load(
        text.partition("twist_covariance_diagonal: ")[2].split("\n")[0]
    )
    side = (0.04 * 0.6 / RPM) ** 2
    assert diagonal[0] == pytest.approx(side / 2, rel=1e-2)
    assert diagonal[5] == pytest.approx(2 * side / 0.2**2, rel=1e-2)


def test_what_was_found_but_is_no_term_is_not_nothing():
    found = answer(DIFFERENTIAL, {}, others=("drift: rotation_gain",))
    text = files_for(found, ("ros2_control",))["ros2_control/real_robot.yaml"]
    assert "Found, but in none of these numbers: drift: rotation_gain" in text
    assert "Nothing was found" not in text


def test_limits_follow_from_the_wheels_and_what_they_are_asked():
    found = answer(DIFFERENTIAL, {"wheel_radius": 0.1, "setpoint_rate_limit": 100.0})
    files = files_for(found, ("ros2_control",))
    for text in files.values():
        if "max_velocity" not in text:
            continue
        limits = {
            name: float(text.partition(f"{name}: ")[2].split()[0].rstrip(","))
            for name in ("linear.x.max_velocity", "angular.z.max_velocity",
                         "linear.x.max_acceleration", "angular.z.max_acceleration")
        }  # fmt: skip
        side = DIFFERENTIAL.max_rpm / RPM * 0.044
        rise = 100.0 / RPM * 0.044
        wanted = (side, 2 * side / 0.2, rise, 2 * rise / 0.2)
        assert tuple(limits.values()) == pytest.approx(wanted, rel=1e-5)
    assert sum("max_velocity" in text for text in files.values()) == 2


def test_what_is_known_of_friction_and_of_the_motions_noise_is_a_comment():
    found = answer(SKID, {"friction_anisotropy.ratio": 1.3})
    files = files_for(found, ("sdf", "robot_localization"))
    assert "1.3 times the friction along" in files["sdf/wheels.sdf"]
    assert "hilserver observe" in files["robot_localization/ekf.yaml"]


def test_the_table_has_a_row_per_number():
    files = files_for(answer(DIFFERENTIAL, {"wheel_radius": 0.1}), ())
    rows = {
        row["name"]: row for row in csv.DictReader(io.StringIO(files["parameters.csv"]))
    }
    assert float(rows["wheel_radius_left"]["value"]) == pytest.approx(0.044)
    assert float(rows["terms.wheel_radius"]["low"]) == pytest.approx(0.09)
    document = json.loads(files["parameters.json"])
    assert [row["name"] for row in document["parameters"]] == list(rows)


def test_a_robot_without_findings_keeps_its_numbers(robot):
    files = files_for(answer(robot, {}), ("ros2_control",))
    assert "Nothing was found" in files["ros2_control/real_robot.yaml"]
    real, simulator = (
        parameters(files, name) for name in ("real_robot.yaml", "simulator.yaml")
    )
    assert real == pytest.approx(simulator)
