"""A few wild samples turn no gross check: each is asked of a sound log and of a faulty one."""

import numpy as np
import pytest

from hilserver.diagnosis.checks import angles, check, frame, orientation, units
from hilserver.diagnosis.checks.motion import line
from hilserver.measured.channels import DUTIES, GYRO, SPEEDS
from tests.diagnosis.checks.samples import ROBOT, drive, log_of

WILD_RAD_S = 9.0


def with_wild(values, size, share=0.009, in_a_row=4, seed=5):
    """The values with a share of wild ones, all of one sign, some in a row."""
    values, rng = np.array(values, float), np.random.default_rng(seed)
    for _ in range(max(round(share * len(values) / in_a_row), 1)):
        first = rng.integers(len(values) - in_a_row)
        values[first : first + in_a_row] = size
    return values


def without_position(**changed):
    t, columns = drive(rate_hz=10.0)
    kept = {name: v for name, v in columns.items() if "speed" in name or name == GYRO}
    return log_of(
        t, {**kept, **{name: change(columns) for name, change in changed.items()}}
    )


@pytest.mark.parametrize("side", [1.0, -1.0], ids=["up", "down"])
def test_a_robot_that_turned_is_not_said_to_stand(side):
    """Its gyro is wild where it turned the other way: the sum of both is almost no turn."""

    def wild(columns):
        gyro = 0.3 * columns[GYRO]
        gyro[np.argsort(side * gyro)[:24]] = side * WILD_RAD_S
        return gyro

    assert frame.unidentified(without_position(**{GYRO: wild}), ROBOT) is None


def test_a_robot_that_stood_is_still_said_to_stand():
    log = without_position(**{GYRO: lambda c: with_wild(0.0 * c[GYRO], WILD_RAD_S)})
    assert "did not turn" in str(frame.unidentified(log, ROBOT))


def test_wild_wheel_speeds_make_no_turn():
    wheels = {name: lambda c, n=name: with_wild(0.0 * c[n], 80.0) for name in SPEEDS}
    log = without_position(**wheels, **{GYRO: lambda c: 0.0 * c[GYRO]})
    assert "hardly turned" in str(frame.unidentified(log, ROBOT))


def test_a_line_passes_wild_samples():
    x = np.sin(0.1 * np.arange(200))
    found = line(with_wild(0.5 * x, 1e4, 0.04, 1), x)
    assert found is not None
    assert found.slope == pytest.approx(0.5, rel=0.01)
    assert found.correlation > 0.99


def test_shares_are_known_beside_a_wild_duty():
    t, columns = drive()
    duty = {
        name: with_wild(0.01 * columns[speed] / ROBOT.process.gain, 80.0, 0.002, 1)
        for name, speed in zip(DUTIES, SPEEDS, strict=True)
    }
    found = units.find(log_of(t, {**columns, **duty}), ROBOT)[1]
    assert [f.regressors for f in found if f.causes == ("unit_error",)] == [DUTIES]


def test_an_angle_wraps_beside_a_wild_one():
    turned = 3.0 * np.arange(4000) * 0.02
    wrapped = np.mod(turned, 2.0 * np.pi)
    wrapped[1234] = 1e5
    log = log_of(np.arange(4000) * 0.02, {"wheel.fl.angle_rad": wrapped})
    assert "wraps at 6.283" in " ".join(angles.find(log, ROBOT)[0].notices)


@pytest.mark.parametrize("mirrored", [False, True], ids=["sound", "mirrored heading"])
def test_wild_positions_turn_no_heading(mirrored):
    t, columns = drive()
    sign = -1.0 if mirrored else 1.0
    columns = {
        **columns,
        "nav.x_m": np.where(
            np.isfinite(columns["nav.x_m"]),
            with_wild(columns["nav.x_m"], 300.0, 0.004, 1),
            np.nan,
        ),
        "nav.yaw_rad": sign * columns["nav.yaw_rad"],
    }
    found = orientation.find(log_of(t, columns), ROBOT)[1]
    assert [f.causes for f in found] == [("sign_flip",)] * mirrored


def test_a_sound_log_with_wild_samples_has_no_fault():
    t, columns = drive()
    columns[GYRO] = with_wild(columns[GYRO], WILD_RAD_S)
    for name in SPEEDS:
        columns[name] = with_wild(columns[name], 150.0, 0.004, 2)
    assert check(log_of(t, columns), ROBOT).findings == ()
