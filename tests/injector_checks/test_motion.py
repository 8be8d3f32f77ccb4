"""The true machine against closed forms."""

import math

import numpy as np
import pytest
from hilserver_injector import make
from hilserver_injector.parameters import (
    GAIN,
    ICR_M,
    K_OM,
    KI,
    KP,
    RADIUS_M,
    T1_S,
    T2_S,
)
from hilserver_injector.sensors import OM, VY, YAW, V, X, Y
from scipy.linalg import expm

RAD_S = math.pi / 30.0


def sampled_step(setpoint_rpm, n):
    """Speed of a PI at 1 ms around the continuous process, by matrix exponentials, unsaturated."""
    a = np.array(
        [[-1 / T1_S, 0.0, GAIN / T1_S], [1 / T2_S, -1 / T2_S, 0.0], [0.0, 0.0, 0.0]]
    )
    over = expm(a * 1e-3)
    state, integral, speeds = np.zeros(3), 0.0, []
    for _ in range(n):
        speeds.append(state[1])
        error = setpoint_rpm - state[1]
        state[2] = KP * error + integral
        integral += 1e-3 * KI * error
        state = over @ state
    return np.array(speeds)


def test_step_response(one_move):
    table, _ = make(one_move(5.0, 5.0, duration_s=1.0))
    ticks = np.round(table.t_s * 1e3).astype(int)
    wanted = sampled_step(5.0, ticks[-1] + 1)[ticks]
    np.testing.assert_allclose(table.columns["wheel.fl.speed_rpm"], wanted, atol=2e-3)
    np.testing.assert_allclose(table.columns["wheel.rr.speed_rpm"], -wanted, atol=2e-3)


def test_forward_is_left_positive_right_negative(one_move):
    table, truth = make(one_move(40.0, 40.0, duration_s=3.0))
    assert table.columns["wheel.fl.speed_rpm"][-1] == pytest.approx(40.0, abs=0.01)
    assert table.columns["wheel.fr.speed_rpm"][-1] == pytest.approx(-40.0, abs=0.01)
    assert truth.dense[-1, V] == pytest.approx(RADIUS_M * 40.0 * RAD_S, rel=1e-4)


def test_left_forward_turns_clockwise(one_move):
    _, truth = make(one_move(20.0, -20.0, duration_s=3.0))
    assert truth.dense[-1, OM] == pytest.approx(
        -2 * RADIUS_M * K_OM * 20.0 * RAD_S, rel=1e-4
    )
    assert truth.dense[-1, YAW] < truth.dense[0, YAW]


def test_circle(one_move):
    """Steady: every point lies on a circle of radius sqrt(v^2 + vy^2)/om."""
    _, truth = make(one_move(20.0, 40.0))
    v = RADIUS_M * 30.0 * RAD_S
    om = RADIUS_M * K_OM * 20.0 * RAD_S
    steady = truth.dense[3000:]
    assert steady[-1, V] == pytest.approx(v, rel=1e-4)
    assert steady[-1, OM] == pytest.approx(om, rel=1e-4)
    assert steady[-1, VY] == pytest.approx(-ICR_M * om, rel=1e-4)
    turn = steady[-1, YAW] - steady[0, YAW]
    chord = math.dist(steady[0, [X, Y]], steady[-1, [X, Y]])
    radius = math.hypot(v, ICR_M * om) / om
    assert chord == pytest.approx(2 * radius * abs(math.sin(turn / 2)), abs=1e-4)


def test_duty_of_a_steady_wheel(one_move):
    """At rest of the loop the duty is n/G + b n + F."""
    causes = {"coulomb_friction": 6.0, "viscous_load": 0.1}
    table, _ = make(one_move(30.0, 30.0, **causes))
    wanted = 30.0 / GAIN + 0.1 * 30.0 + 6.0
    assert table.columns["wheel.rl.duty_pct"][-1] == pytest.approx(wanted, rel=1e-3)


def test_speed_follows_the_voltage_at_the_limit(one_move):
    table, _ = make(one_move(89.0, 89.0, battery_sag=1.0, saturation_limit=60.0))
    voltage = table.columns["battery.voltage_v"][-1]
    wanted = 60.0 * GAIN * voltage / 19.2
    assert table.columns["wheel.fl.speed_rpm"][-1] == pytest.approx(wanted, rel=2e-3)


@pytest.mark.parametrize(
    ("ratio", "offset_m", "k_om", "icr_m"),
    [(1.0, 0.0, K_OM, 0.0), (1.0, 0.0127, 2.009, 0.020), (2.24, 0.050, 1.0, 0.020)],
)
def test_tyres_turn_as_the_physics_page_says(one_move, ratio, offset_m, k_om, icr_m):
    recipe = one_move(
        -40.0,
        40.0,
        duration_s=3.0,
        friction_anisotropy__ratio=ratio,
        friction_anisotropy__offset=offset_m,
    )
    _, truth = make(recipe)
    om = truth.dense[-1, OM]
    assert om / (2 * RADIUS_M * 40.0 * RAD_S) == pytest.approx(k_om, rel=0.02)
    assert -truth.dense[-1, VY] / om - ICR_M == pytest.approx(icr_m, abs=0.003)
