from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.errors import LogError
from hilserver.identify.step_response import identify_steps
from hilserver.identify.strejc import (
    chain_of_lags,
    find_tangent,
    read_tangent,
    tangent_of_chain,
    two_constants,
    two_lags,
)
from tests.identify.drives import STEP_S, loop, measured

T_S = np.arange(0.0, 12.0, 0.01)


@pytest.mark.parametrize(
    ("order", "ratio", "rise"),
    [
        (2, 0.104, 2.718),
        (3, 0.218, 3.695),
        (4, 0.319, 4.463),
        (5, 0.410, 5.119),
        (6, 0.493, 5.699),
    ],
)
def test_table_of_the_method(order, ratio, rise):
    tangent = tangent_of_chain(order)
    assert tangent.ratio == pytest.approx(ratio, abs=1e-3)
    assert tangent.rise_s == pytest.approx(rise, abs=1e-3)


@pytest.mark.parametrize("order", [2, 3, 4])
def test_tangent_of_a_chain_gives_its_order_and_time_constant(order):
    found = read_tangent(find_tangent(T_S, chain_of_lags(T_S, order, 0.6)))
    assert found.order == order
    assert found.time_constant_s == pytest.approx(0.6, rel=0.08)


@settings(max_examples=40, deadline=None)
@given(st.floats(0.1, 1.0), st.floats(0.02, 0.95))
def test_two_points_give_two_time_constants(t1_s, ratio):
    found = two_constants(T_S, two_lags(T_S, t1_s, ratio * t1_s))
    assert sum(found) == pytest.approx((1.0 + ratio) * t1_s, rel=0.03)
    assert found[0] >= found[1]
    assert found[0] == pytest.approx(t1_s, rel=0.2)


def test_equal_time_constants_are_the_limit_of_unequal_ones():
    same = two_lags(T_S, 0.3, 0.3)
    np.testing.assert_allclose(same, two_lags(T_S, 0.3, 0.3 * (1 - 1e-5)), atol=1e-5)
    np.testing.assert_allclose(same, chain_of_lags(T_S, 2, 0.3), atol=1e-12)


def bench(seed, rate_hz=500.0, noise=0.12):
    """Steps of the duty with the wheels in the air; the exact answer, not an integrator's."""
    rng = np.random.default_rng(seed)
    levels = [0.0, 30.0, 60.0, 20.0, -40.0, 0.0, 50.0, 10.0, -20.0]
    t_s = np.arange(0.0, 5.4, 1.0 / rate_hz)
    speed, duty = noise * rng.normal(size=len(t_s)), np.zeros(len(t_s))
    for k, (before, after) in enumerate(pairwise(levels), start=1):
        since_s = t_s - 0.6 * k
        duty[since_s >= -1e-9] = after
        speed += 1.11 * (after - before) * two_lags(since_s, 0.069, 0.0023)
    return measured(t_s, {"wheel.fl.duty_pct": duty, "wheel.fl.speed_rpm": speed})


def test_process_of_the_thesis_is_identified_from_steps_of_the_duty():
    found = identify_steps(bench(1))
    assert found.input == "duty_pct"
    assert found.steps == 8
    assert found.gain.value == pytest.approx(1.11, rel=0.005)
    assert found.t1.value == pytest.approx(0.069, rel=0.02)
    assert found.t2.value == pytest.approx(0.0023, rel=0.05)
    assert found.strejc.order == 1
    assert found.two_point_s[0] == pytest.approx(0.069, rel=0.1)
    assert found.rms_rpm[1] == pytest.approx(0.12, rel=0.1)
    assert found.flags == ()


def test_intervals_hold_the_truth():
    held = np.zeros(3)
    for seed in range(30):
        found = identify_steps(bench(seed, rate_hz=200.0))
        held += [found.gain.holds(1.11), found.t1.holds(0.069), found.t2.holds(0.0023)]
    assert (held >= 24).all()


def test_set_points_show_the_closed_loop_and_say_so():
    aim = np.repeat([0.0, 2.0, 4.0, 1.0, 3.0], 5000)
    speed, duty = loop(aim)
    rows = slice(0, len(aim), 10)
    t_s = np.arange(len(aim))[rows] * STEP_S
    values = {
        "wheel.fl.setpoint_rpm": aim[rows],
        "wheel.fl.duty_pct": duty[rows],
        "wheel.fl.speed_rpm": speed[rows],
    }
    found = identify_steps(measured(t_s, values))
    assert found.input == "setpoint_rpm"
    assert found.gain.value == pytest.approx(1.0, abs=0.03)
    assert found.t1.value < 0.02
    assert any("closed loop" in flag for flag in found.flags)


def test_log_without_steps_is_refused():
    t_s = np.arange(0.0, 5.0, 0.01)
    values = {"wheel.fl.duty_pct": np.sin(t_s), "wheel.fl.speed_rpm": np.sin(t_s)}
    with pytest.raises(LogError, match="no wheel has a step"):
        identify_steps(measured(t_s, values))


def test_wheel_that_does_not_answer_is_refused():
    t_s = np.arange(0.0, 5.0, 0.01)
    values = {
        "wheel.fl.duty_pct": 10.0 * (t_s // 1.0 % 2),
        "wheel.fl.speed_rpm": np.zeros_like(t_s),
    }
    with pytest.raises(LogError, match="do not follow"):
        identify_steps(measured(t_s, values))
