"""Prediction: the plant's own motion, and its derivatives."""

import numpy as np
import pytest

from hilserver.observer.layout import BIAS, N_ESTIMATED, OM, YAW, Head, Moment, V, X, Y
from hilserver.observer.motion import move_on, predict
from hilserver.plant.parameters import MECANUM_GEOMETRY, RobotParameters
from tests.observer.rig import DT_S, MANY, Observed, numerical, robot
from tests.plant.rig import Rig

STATE = np.array([0.5, -0.3, 2.2, 0.4, 0.7, 0.01, 0.02, -0.01, 0.03, 0.02, -0.03])


def two(left=(5.0, 5.2), right=(-3.0, -3.4)):
    before, now = Moment.zeros(), Moment.zeros()
    now.time = DT_S
    (before.left, now.left), (before.right, now.right) = left, right
    before.estimate[:] = STATE
    return before, now


def moved(observed, before, now, state):
    before.estimate[:] = state
    out = np.zeros(N_ESTIMATED)
    move_on(observed.p, observed.figures, before, now, out)
    before.estimate[:] = STATE
    return out


@pytest.mark.parametrize("terms", [{}, MANY, MANY | {"body_lag": 0.0}])
@pytest.mark.parametrize(
    "right", [(-3.0, -3.4), (-5.0, -5.2)], ids=["turning", "straight"]
)
def test_transition_is_the_derivative_of_the_motion(terms, right):
    observed, (before, now) = Observed(robot(**terms), unknown={}), two(right=right)
    observed.figures.wheel_sd = observed.figures.wheel_drift = 0.0
    derivative = numerical(lambda x: moved(observed, before, now, x), STATE)
    root = np.random.default_rng(0).standard_normal((N_ESTIMATED, N_ESTIMATED))
    before.covariance[:] = root @ root.T
    f = observed.figures
    f.position_ou = f.yaw_ou = f.bias_walk = f.slip_walk = f.gain_walk = 0.0
    c = observed.c.copy()
    c[: f.n_words] = f.numbers
    predict(observed.p, c, Head.zeros(), before, now)
    expected = derivative @ before.covariance @ derivative.T
    np.testing.assert_allclose(now.covariance, expected, rtol=1e-6, atol=1e-7)


def test_noise_of_the_wheels_is_what_it_does_to_the_motion():
    """Both readings disturbed by one deviation each give the covariance that is added."""
    terms = MANY | {"longitudinal_slip": 0.0, "rotation_gain_speed": 0.0}
    observed, (before, now) = Observed(robot(**terms), unknown={}), two()
    f = observed.figures
    f.position_ou = f.yaw_ou = f.bias_walk = f.slip_walk = f.gain_walk = 0.0
    f.wheel_drift = 0.0
    c = observed.c.copy()
    c[: f.n_words] = f.numbers
    nothing, expected = (
        moved(observed, before, now, STATE),
        np.zeros((N_ESTIMATED, N_ESTIMATED)),
    )
    for side in ("left", "right"):
        exact = now[side]
        now[side] = exact + f.wheel_sd
        change = moved(observed, before, now, STATE) - nothing
        now[side] = exact
        expected += np.outer(change, change)
    predict(observed.p, c, Head.zeros(), before, now)
    got = now.covariance
    # what changes slip and gain with the speed is left out, and so is the state's own share of them
    np.testing.assert_allclose(got[:5, :5], expected[:5, :5], rtol=0.1, atol=2e-11)
    assert got[BIAS, BIAS] == 0.0


ROLLERS = {
    "wheel_radius": 0.02,
    "roller_slip": 0.1,
    "encoder_scale.a": 0.03,
    "rotation_gain": 0.03,
}


@pytest.mark.parametrize(
    "own",
    [
        {"terms": MANY | {"encoder_scale.a": 0.0}},
        {"drive": "mecanum", **MECANUM_GEOMETRY, "terms": ROLLERS},
    ],
    ids=["skid", "mecanum"],
)
def test_a_robot_is_followed_without_any_sensor(own):
    """From a known pose the wheels' speeds alone give the plant's motion."""
    rig, observed = Rig(**own), Observed(RobotParameters(**own))
    rig.u.twist_lateral = 0.1 * rig.robot.is_mecanum
    rig.twist(0.2, 0.3).step(2000)
    scale = 2.0 * np.pi / 60.0
    for k in range(1000):
        speed = rig.y.speed * scale
        apart = speed[0] - speed[1], speed[2] - speed[3]
        m = observed.step(0.005 * k, speed[:2].mean(), speed[2:].mean(), apart=apart)
        if k == 0:
            m.estimate[:3] = rig.y.pose
            m.estimate[[V, OM]] = rig.y.linear, rig.y.angular
        if k == 500:
            rig.twist(0.3, -0.4)
        last = [*rig.y.pose]
        rig.step(5)
    assert m.estimate[[X, Y]] == pytest.approx(last[:2], abs=6e-3)
    assert np.cos(m.estimate[YAW] - last[2]) > 1.0 - 1e-5
