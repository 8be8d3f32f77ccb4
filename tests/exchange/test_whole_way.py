"""From a file of a robot and a log to the file for it: read, diagnosed, written, read again.

The logs are those of another program than the plant, which hides effects in them.
"""

import re

import pytest
from hilserver_injector import Recipe, make

from benchmarks.diagnose_worker import measured
from hilserver.commands import main
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.diagnosis.engine import diagnose
from hilserver.diagnosis.for_others import user_files
from hilserver.exchange import read_robot
from hilserver.exchange.geometry import DriveGeometry, patched
from hilserver.plant.parameters import RobotParameters
from tests.exchange.robots import robot_of

SKID = RobotParameters()
MECANUM = RobotParameters(
    drive="mecanum",
    wheel_radius_m=0.05,
    wheelbase_m=0.25,
    track_m=0.36,
    icr_offset_m=0.0,
)
OF_TWO_WHEELS = f"""\
base:
  ros__parameters:
    use_sim_time: false
    wheel_separation: {SKID.track_m}
    wheel_separation_multiplier: {1.0 / (SKID.k_om * SKID.track_m)}
    wheel_radius: {SKID.wheel_radius_m}
"""
OF_ROLLERS = """\
base:
  ros__parameters:
    kinematics.wheels_radius: 0.05
    kinematics.sum_of_robot_center_projection_on_X_Y_axis: 0.305
"""
WHEEL = (
    '<link name="{0}"><collision><geometry><cylinder radius="0.085" length="0.04"/></geometry>'
    '</collision></link><joint name="{0}_joint" type="continuous"><parent link="base_link"/>'
    '<child link="{0}"/><origin xyz="{1} {2} 0"/><axis xyz="0 1 0"/></joint>'
)
PLACES = ((0.125, 0.155), (-0.125, 0.155), (0.125, -0.155), (-0.125, -0.155))
OF_FOUR_WHEELS = (
    '<robot name="a"><link name="base_link"/>'
    + "".join(WHEEL.format(f"wheel{i}", *place) for i, place in enumerate(PLACES))
    + "</robot>"
)


@pytest.mark.parametrize(
    ("robot", "name", "text", "causes", "how"),
    [
        (SKID, "own.yaml", OF_TWO_WHEELS, {"rotation_gain": -0.08},
         {"seed": 1, "duration_s": 60.0}),
        pytest.param(SKID, "own.urdf", OF_FOUR_WHEELS,
                     {"wheel_radius": 0.04, "rotation_gain": 0.1},
                     {"seed": 2, "duration_s": 240.0}, marks=pytest.mark.long),
        pytest.param(MECANUM, "own.yaml", OF_ROLLERS, {"wheel_radius": 0.04},
                     {"seed": 64, "duration_s": 240.0, "drive": "mecanum",
                      "manoeuvre": "omni"}, marks=pytest.mark.long),
    ],
    ids=["two wheels", "four wheels", "mecanum"],
)  # fmt: skip
def test_what_was_hidden_stands_in_the_file_for_the_real_robot(
    tmp_path, robot, name, text, causes, how
):
    (tmp_path / name).write_text(text)
    described = read_robot(tmp_path / name)
    assert robot_of(described).k_om == pytest.approx(robot.k_om)
    assembly = assemble_config(
        Config().changed(
            plant=described.plant, kinematics={"rotation_gain": described.rotation_gain}
        )
    )
    log = measured(make(Recipe(causes=causes, **how))[0])
    found = diagnose(log, assembly, jobs=1)
    written = user_files(found, found.robot, ("ros2_control",))
    (tmp_path / "real.yaml").write_text(written["for/ros2_control/real_robot.yaml"])

    again = read_robot(tmp_path / "real.yaml")
    difference = {"wheel_radius_difference": again.wheel_radius_difference}
    got = DriveGeometry.of(patched(robot_of(again), difference))
    true = DriveGeometry.of(patched(robot, causes))
    numbers = {
        "separation/wheel_separation": (got.separation_m, true.separation_m),
        "left radius/wheel_radius": (got.left_m, true.left_m),
        "right radius/wheel_radius": (got.right_m, true.right_m),
        "wheels_radius": (got.radius_m, true.radius_m),
        "sum_of_robot_center_projection_on_X_Y_axis": (
            got.separation_m / 2.0, true.separation_m / 2.0
        ),
    }  # fmt: skip
    said = re.findall(
        r"# (\S+| ?\S+ \S+) (\S+) \+- (\S+) \(95 %\)",
        (tmp_path / "real.yaml").read_text(),
    )
    assert len(said) == (2 if robot.is_mecanum else 3)
    for what, value, half in said:
        written_m, true_m = numbers[what]
        # as a ratio to a number of the file; what nothing was found of has no interval
        unit_m = written_m / float(value)
        assert abs(written_m - true_m) <= float(half) * unit_m + 1e-6 * true_m
        assert float(half) < 0.03 * float(value)
    assert any(float(half) > 0.0 for _, _, half in said)


def test_a_log_that_shows_nothing_gives_no_files(tmp_path, capsys):
    names = [f"wheel.{wheel}.speed_rpm" for wheel in ("fl", "rl", "fr", "rr")]
    lines = [",".join(["t_s", *names, "nav.x_m", "nav.y_m"])]
    lines += [f"{0.1 * row:.1f},0,0,0,0,1.0,2.0" for row in range(300)]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    words = ["diagnose", str(tmp_path / "log.csv"), "--for", "ros2_control"]
    assert main([*words, "-o", str(tmp_path / "out"), "--jobs", "1"]) == 0
    assert "no files for other programs" in capsys.readouterr().err
    assert not (tmp_path / "out" / "for").exists()
