"""Odometry of a driver stands for the wheel speeds that it was made of."""

import numpy as np
import pytest

from hilserver.diagnosis.regression.stages import foretold
from hilserver.errors import LogError
from hilserver.measured.channels import SPEEDS
from hilserver.measured.machine import machine
from hilserver.measured.reading import read_measured
from hilserver.plant.parameters import RobotParameters

RADIUS_M, TRACK_M = 0.1, 0.4
MAPPING = """
plant: {wheel_radius_m: 0.1, track_m: 0.5}
odom: {wheel_radius_m: 0.1, track_m: 0.4}
channels:
  odom.linear_m_s: {column: v}
  odom.angular_rad_s: {column: w, unit: deg/s}
  nav.x_m: {column: x}
  nav.y_m: {column: y}
  nav.yaw_rad: {column: yaw}
"""


@pytest.fixture
def table(tmp_path):
    """A twist with a pose, as /odom and motion capture give it."""
    t = np.arange(500) * 0.02
    v, w = 0.5 + 0.2 * np.sin(t), 0.6 * np.cos(0.7 * t)
    yaw = np.cumsum(w) * 0.02
    x, y = np.cumsum(v * np.cos(yaw)) * 0.02, np.cumsum(v * np.sin(yaw)) * 0.02
    path = tmp_path / "run.csv"
    rows = np.column_stack([t, v, np.degrees(w), x, y, np.angle(np.exp(1j * yaw))])
    np.savetxt(path, rows, delimiter=",", header="t_s,v,w,x,y,yaw", comments="")
    return path, v, w


def read(path, text):
    mapping = path.parent / "mapping.yaml"
    mapping.write_text(text)
    return read_measured([path], mapping)


def test_the_wheels_turn_as_the_driver_had_them(table):
    path, v, w = table
    log = read(path, MAPPING)
    left, right = (
        log[name].values * np.pi / 30.0 * RADIUS_M for name in (SPEEDS[0], SPEEDS[3])
    )
    assert (left - right) / 2.0 == pytest.approx(v, abs=1e-6)
    assert -(left + right) / TRACK_M == pytest.approx(w, abs=1e-6)
    assert log.notices == ("the wheel speeds were computed from the odometry",)
    assert "the motion by position, heading" in foretold(
        log, machine(log, RobotParameters())
    )


def test_what_of_the_driver_is_unknown_is_said(table):
    log = read(
        table[0], MAPPING.replace("odom: {wheel_radius_m: 0.1, track_m: 0.4}", "")
    )
    assert "wheel_radius_m and track_m of its driver is unknown" in log.notices[0]
    rims = log[SPEEDS[0]].values + log[SPEEDS[3]].values
    assert -rims * np.pi / 30.0 * 0.1 / 0.5 == pytest.approx(table[2], abs=1e-6)


@pytest.mark.parametrize(
    ("gone", "words"),
    [
        ("  odom.angular_rad_s: {column: w, unit: deg/s}\n", "needs odom.angular_rad_s beside"),
        ("plant: {wheel_radius_m: 0.1, track_m: 0.5}\nodom: {wheel_radius_m: 0.1, track_m: 0.4}",
         "without wheel_radius_m; write plant:"),
    ],
)  # fmt: skip
def test_what_is_missing_is_said_with_its_remedy(table, gone, words):
    with pytest.raises(LogError, match=words):
        read(table[0], MAPPING.replace(gone, ""))


def test_own_wheel_speeds_come_first(table):
    wheels = "".join(f"  {name}: {{column: v, unit: rad/s}}\n" for name in SPEEDS)
    log = read(table[0], MAPPING + wheels)
    assert log[SPEEDS[0]].values == pytest.approx(table[1] * 30.0 / np.pi)
    assert log.notices == ("the odometry is not used beside wheel speeds",)
