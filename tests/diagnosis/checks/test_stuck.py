"""A sensor that never changes although the robot moves; and channels that rightly stay the same."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import check
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

NAV = ("nav.x_m", "nav.y_m", "nav.yaw_rad")


@pytest.fixture(scope="module")
def table():
    return drive(11, length_s=60.0)


def held(columns, names, value):
    """The table with some channels that have one value wherever they have any."""
    return {
        name: np.where(np.isnan(values), np.nan, value) if name in names else values
        for name, values in columns.items()
    }


@pytest.mark.parametrize("value", [0.0, 1.25])
@pytest.mark.parametrize(
    "names",
    [
        ("nav.x_m",),
        ("nav.x_m", "nav.y_m"),
        NAV,
        ("nav.yaw_rad",),
        ("imu.gyro_z_rad_s",),
        ("wheel.rl.speed_rpm",),
    ],
    ids=lambda names: names[-1],
)
def test_a_stuck_channel_is_named_and_left_out(table, names, value):
    t, columns = table
    checked = check(log_of(t, held(columns, names, value)), ROBOT)
    (finding,) = checked.findings
    assert finding.causes == ("held_samples",)
    assert set(finding.regressors) == set(names)
    assert finding.parameters["held_samples"].value == 0.0
    assert not set(names) & set(checked.log.channels)


def test_a_robot_that_stands_has_no_stuck_channel(table):
    t, columns = table
    still = [
        name
        for name in columns
        if name.startswith("wheel.") or name == "imu.gyro_z_rad_s"
    ]
    assert check(log_of(t, held(columns, still, 0.0)), ROBOT).findings == ()


def test_a_simulated_robot_without_noise_may_keep_a_coordinate():
    t, columns = drive(12, length_s=60.0, noise=0.0)
    speed = columns["wheel.fl.setpoint_rpm"]
    for wheel, sign in (("rl", 1), ("fr", -1), ("rr", -1)):
        columns[f"wheel.{wheel}.setpoint_rpm"] = sign * speed
        columns[f"wheel.{wheel}.speed_rpm"] = sign * columns["wheel.fl.speed_rpm"]
    way = np.cumsum(columns["wheel.fl.speed_rpm"]) * 0.085 * np.pi / 30.0 / 50.0
    straight = {**held(columns, ("nav.y_m", "nav.yaw_rad", "imu.gyro_z_rad_s"), 0.0)}
    straight["nav.x_m"] = np.where(np.isnan(columns["nav.x_m"]), np.nan, way)
    assert check(log_of(t, straight), ROBOT).findings == ()
