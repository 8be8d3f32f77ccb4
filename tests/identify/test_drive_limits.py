"""Update rate, dead zone and noise at rest."""

import numpy as np
import pytest

from hilserver.errors import LogError
from hilserver.identify.dead_zone import identify_dead_zone
from hilserver.identify.resting_noise import identify_noise
from hilserver.identify.update_rate import compare, identify_update_rate
from tests.identify.drives import correlated, measured


def incremental(period_ms, row_ms, seed=0):
    """A controller that adds a little to its command once per period; speed lags by 20 ms."""
    rng = np.random.default_rng(seed)
    speed, command, rows = 0.0, 0.0, []
    due_ms = 0.0
    for ms in range(2000):
        if ms >= due_ms:
            command += np.clip(0.02 * (200.0 - speed), -4.0, 4.0)
            due_ms += period_ms + rng.normal() * 0.05 * period_ms
        speed += (2.0 * max(command - 20.0, 0.0) - speed) / 20.0
        if ms % row_ms == 0:
            rows.append((ms * 1e-3, 200.0, command, speed))
    t_s, aim, duty, turned = np.array(rows).T
    return measured(
        t_s,
        {
            "wheel.fl.setpoint_rpm": aim,
            "wheel.fl.duty_pct": duty / 2.55,
            "wheel.fl.speed_rpm": turned,
        },
    )


@pytest.mark.parametrize("period_ms", [3, 5, 10, 20])
def test_update_period_is_found(period_ms):
    found = identify_update_rate(incremental(period_ms, row_ms=1))
    assert found.period_s.value == pytest.approx(period_ms * 1e-3, rel=0.1)
    assert (
        found.period_s.ci95[0] - 5e-4
        <= period_ms * 1e-3
        <= found.period_s.ci95[1] + 5e-4
    )
    assert found.rises[0].rise_s.ci95[0] <= found.rises[0].rise_s.value


def test_controllers_are_ordered_and_only_different_ones_told_apart():
    rates = [
        identify_update_rate(incremental(p, 1, seed=i))
        for i, p in enumerate((10, 5, 5.05))
    ]
    first, second = compare(rates)
    assert not first.distinguishable
    assert second.distinguishable
    assert second.p_value < 1e-3


def test_rows_too_far_apart_to_see_the_controller_are_refused():
    with pytest.raises(LogError, match="faster than the row rate"):
        identify_update_rate(incremental(1, row_ms=20))


def test_log_without_a_step_is_refused():
    t_s = np.arange(0.0, 2.0, 0.01)
    names = ("setpoint_rpm", "duty_pct", "speed_rpm")
    still = measured(t_s, {f"wheel.fl.{name}": np.zeros_like(t_s) for name in names})
    with pytest.raises(LogError, match="always 0"):
        identify_update_rate(still)
    with pytest.raises(LogError, match="needs setpoint_rpm"):
        identify_update_rate(measured(t_s, {"wheel.fl.speed_rpm": t_s}))


def test_a_step_ends_where_the_setpoint_changes_again():
    log = incremental(5, row_ms=1)
    setpoint = log["wheel.fl.setpoint_rpm"]
    back = setpoint.with_values(np.where(setpoint.t_s < 1.0, setpoint.values, 0.0))
    stopped = log["wheel.fl.speed_rpm"]
    stopped = stopped.with_values(np.where(stopped.t_s < 1.0, stopped.values, 0.0))
    changed = log.with_channels(
        {"wheel.fl.setpoint_rpm": back, "wheel.fl.speed_rpm": stopped}
    )
    (rise,), (whole,) = (identify_update_rate(each).rises for each in (changed, log))
    assert rise.rise_s.value == pytest.approx(whole.rise_s.value, rel=0.05)
    short = setpoint.with_values(np.where(setpoint.t_s < 0.005, setpoint.values, 0.0))
    with pytest.raises(LogError, match="hold the set-point longer"):
        identify_update_rate(log.with_channels({"wheel.fl.setpoint_rpm": short}))


def sweep(low, high, held=False):
    duty = np.arange(-60.0, 61.0, 1.0)
    speed = np.where(
        duty < low, (duty - low) * 3.0, np.where(duty > high, (duty - high) * 3.0, 0)
    )
    if held:
        speed[(duty >= low) & (duty <= 0.0)] = -7.3
    return measured(
        np.arange(len(duty)), {"wheel.fl.duty_pct": duty, "wheel.fl.speed_rpm": speed}
    )


@pytest.mark.parametrize("held", [False, True])
def test_dead_zone_lies_between_the_last_turning_and_the_first_resting_duty(held):
    (zone,) = identify_dead_zone(sweep(-15.0, 25.0, held))
    assert zone.lower_pct.ci95 == (-16.0, -15.0)
    assert zone.upper_pct.ci95 == (25.0, 26.0)
    assert (zone.held_rows > 0) == held


def test_equal_speeds_far_from_rest_are_measured():
    duty = np.arange(-60.0, 61.0, 1.0)
    coarse = 30.0 * np.round(
        np.sign(duty) * np.maximum(np.abs(duty) - 12.0, 0.0) / 10.0
    )
    log = measured(duty, {"wheel.fl.duty_pct": duty, "wheel.fl.speed_rpm": coarse})
    (zone,) = identify_dead_zone(log)
    assert zone.held_rows == 0
    assert (zone.lower_pct.value, zone.upper_pct.value) == (-17.5, 17.5)


def test_a_sweep_that_never_rests_is_refused():
    duty = np.arange(10.0, 60.0)
    log = measured(duty, {"wheel.fl.duty_pct": duty, "wheel.fl.speed_rpm": duty})
    with pytest.raises(LogError, match="swept"):
        identify_dead_zone(log)


def standing(turning):
    rng = np.random.default_rng(3)
    t_s = np.arange(0.0, 120.0, 0.05)
    moving = (t_s > 40.0) & (t_s < 60.0) if turning else np.zeros(len(t_s), dtype=bool)
    return measured(
        t_s,
        {
            "wheel.fl.speed_rpm": np.where(moving, 50.0, 0.0)
            + 0.12 * rng.normal(size=len(t_s)),
            "nav.x_m": np.where(moving, 3.0 * t_s, 0.0)
            + correlated(rng, t_s, 0.05, 0.6)
            + 0.01 * rng.normal(size=len(t_s)),
        },
    )


@pytest.mark.parametrize("turning", [False, True])
def test_noise_is_that_of_the_standing_robot(turning):
    position, speed = identify_noise(standing(turning))
    assert (position.channel, speed.channel) == ("nav.x_m", "wheel.fl.speed_rpm")
    assert position.noise.ou_sd == pytest.approx(0.05, rel=0.2)
    assert position.noise.white_sd == pytest.approx(0.01, rel=0.3)
    assert speed.noise.white_sd == pytest.approx(0.12, rel=0.05)
    assert speed.noise.ou_sd == 0.0


def test_a_robot_that_never_stands_is_refused():
    t_s = np.arange(0.0, 60.0, 0.05)
    log = measured(t_s, {"wheel.fl.speed_rpm": np.full(len(t_s), 30.0), "nav.x_m": t_s})
    with pytest.raises(LogError, match="never stands still"):
        identify_noise(log)
    assert len(identify_noise(log, everywhere=True)) == 2


def test_a_duty_quicker_than_the_wheels_shows_no_dead_zone():
    """In an ordinary drive a wheel is at rest for a moment at nearly any duty."""
    t_s = np.arange(0.0, 20.0, 0.02)
    duty = 80.0 * np.sin(2.0 * t_s)
    speed = 3.0 * np.roll(duty, 20)
    log = measured(
        t_s, {"wheel.fl.duty_pct": duty, "wheel.fl.speed_rpm": np.round(speed / 9) * 9}
    )
    with pytest.raises(LogError, match="slower than the wheels"):
        identify_dead_zone(log)
