import numpy as np
import pytest

from hilserver.errors import LogError
from hilserver.identify.consistency import check_sides, check_sign
from hilserver.identify.rotation import identify_rotation
from hilserver.plant.parameters import RobotParameters
from tests.identify.drives import correlated, measured, spins

ROBOT = RobotParameters()
GYRO = "imu.gyro_z_rad_s"
STEADY = 1.12
UNSTEADY = 1.036


@pytest.fixture(scope="module")
def punctual():
    return spins(STEADY, rng=np.random.default_rng(1))


@pytest.fixture(scope="module")
def late():
    """The reversal is chosen so that an IMU 75 ms late makes the thesis's 1.036 of its 1.12."""
    return spins(STEADY, imu_late_s=0.075, reverse_s=1.35, rng=np.random.default_rng(1))


def drop(values, *parts):
    return {
        name: v for name, v in values.items() if not any(part in name for part in parts)
    }


def test_punctual_imu_gives_one_gain_from_all_samples(punctual):
    found = identify_rotation(measured(*punctual), ROBOT)
    for estimate in (found.unsteady, found.steady, found.without_lag):
        assert estimate.value == pytest.approx(STEADY, rel=0.005)
        assert estimate.ci95[0] <= estimate.value <= estimate.ci95[1]
    assert abs(found.lag_s.value) < 0.002
    assert found.flags == ()
    assert found.steady_share > 0.5


def test_late_imu_makes_the_thesis_unsteady_figure_and_is_flagged(late):
    found = identify_rotation(measured(*late), ROBOT)
    assert found.unsteady.value == pytest.approx(UNSTEADY, abs=0.006)
    assert found.steady.value == pytest.approx(STEADY, abs=0.006)
    assert found.without_lag.value == pytest.approx(STEADY, abs=0.006)
    assert found.lag_s.value == pytest.approx(0.075, abs=0.002)
    assert not found.unsteady.holds(STEADY)
    assert any("75 ms" in flag and "unsteady" in flag for flag in found.flags)


def test_the_printed_form_of_2_34_would_be_the_inverse(punctual):
    t_s, values = punctual
    wheels = sum(values[f"wheel.{w}.speed_rpm"] for w in ("fl", "fr"))
    u = -0.085 * wheels * 2.0 * np.pi / 60.0
    y = values[GYRO]
    printed = (u @ y) / (y @ y)
    assert printed == pytest.approx(1.0 / STEADY, rel=0.005)
    correct = identify_rotation(measured(t_s, values), ROBOT).unsteady.value
    assert correct == pytest.approx((u @ y) / (u @ u), rel=2e-3)


def test_too_short_settling_lets_the_lag_into_the_steady_estimate(late):
    hasty = identify_rotation(measured(*late), ROBOT, settle_s=0.001)
    assert hasty.steady.value < 0.98 * STEADY


def test_yaw_angle_serves_where_no_rate_was_recorded(punctual):
    t_s, values = punctual
    found = identify_rotation(measured(t_s, drop(values, "gyro")), ROBOT)
    assert found.channel == "imu.yaw_rad"
    assert found.unsteady.value == pytest.approx(STEADY, rel=0.005)


def test_interval_holds_under_autocorrelation(punctual):
    t_s, values = punctual
    rows = slice(0, len(t_s), 2)
    clean = {name: v[rows] for name, v in drop(values, "yaw", "duty").items()}
    held = 0
    for seed in range(60):
        noise = correlated(np.random.default_rng(seed), t_s[rows], 0.1, 2.0)
        log = measured(
            t_s[rows], {**clean, GYRO: clean[GYRO] + noise}, has_stamps=False
        )
        held += identify_rotation(log, ROBOT).unsteady.holds(STEADY)
    assert held >= 52  # 0.1 % chance at a coverage of 95 %


def test_flipped_yaw_fails_the_sign_check(punctual):
    t_s, values = punctual
    right = identify_rotation(measured(t_s, values), ROBOT)
    flipped = identify_rotation(measured(t_s, {**values, GYRO: -values[GYRO]}), ROBOT)
    assert check_sign(right).passed is True
    assert check_sign(flipped).passed is False
    assert any("negative" in flag for flag in flipped.flags)


def test_offset_that_moves_the_gain_is_flagged():
    rng = np.random.default_rng(2)
    t_s, values = spins(STEADY, reverse_s=1000.0, duration_s=60.0, rng=rng)
    slow = np.linspace(1.0, 0.5, len(t_s))
    for name in values:
        values[name] = values[name] * slow
    values[GYRO] = values[GYRO] + 0.05
    found = identify_rotation(measured(t_s, values), ROBOT)
    assert any("offset" in flag for flag in found.flags)


def test_front_and_rear_are_compared(punctual):
    t_s, values = punctual
    assert [c.passed for c in check_sides(measured(t_s, values))] == [True, True]
    values = {**values, "wheel.rl.speed_rpm": 0.9 * values["wheel.rl.speed_rpm"]}
    left, right = check_sides(measured(t_s, values))
    assert (left.passed, right.passed) == (False, True)
    assert left.figure.value == pytest.approx(0.9, abs=0.005)
    missing = check_sides(measured(t_s, drop(values, "rl.")))
    assert missing[0].passed is None


def test_wheels_that_never_reach_the_set_point_give_no_steady_estimate(punctual):
    t_s, values = punctual
    far = {n: v * 1.3 if "setpoint" in n else v for n, v in values.items()}
    found = identify_rotation(measured(t_s, far), ROBOT)
    assert found.steady is None
    assert any("never within" in flag for flag in found.flags)
    wide = identify_rotation(measured(t_s, far), ROBOT, zone_rpm=25.0)
    assert wide.steady.value == pytest.approx(STEADY, rel=0.01)


@pytest.mark.parametrize(
    ("missing", "words"),
    [
        (("imu",), "needs one of imu.gyro"),
        (("fl.speed", "rl.speed"), "wheel.fl.speed_rpm"),
    ],
)
def test_what_is_missing_is_named(punctual, missing, words):
    t_s, values = punctual
    with pytest.raises(LogError, match=words):
        identify_rotation(measured(t_s, drop(values, *missing)), ROBOT)


def test_a_drive_without_turning_is_refused(punctual):
    t_s, values = punctual
    still = {name: np.zeros_like(v) for name, v in values.items()}
    with pytest.raises(LogError, match="hardly turns"):
        identify_rotation(measured(t_s, still), ROBOT)
