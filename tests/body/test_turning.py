"""Turning in place: the rotation gain that four scrubbing tyres have."""

import math

import pytest

from hilserver.plant.friction import balance
from tests.body.rig import Body

GEOMETRIC = 0.31 / (0.25**2 + 0.31**2)


def gain_and_icr(rpm, **changes):
    """K_om [1/m] and X_ICR [m] of a robot that turns left at `rpm`."""
    w = rpm * 2.0 * math.pi / 60.0
    body = Body(**changes).run(1.5, -w, -w, w, w)
    _, vy, om = body.measured(0.5, -w, -w, w, w)
    return om / (2.0 * 0.085 * w), -vy / om


def test_the_gain_does_not_depend_on_the_step():
    gains = [gain_and_icr(80, step_s=step_s)[0] for step_s in (0.0005, 0.001, 0.002)]
    assert max(gains) / min(gains) - 1.0 < 0.005
    assert gains == pytest.approx([GEOMETRIC] * 3, rel=0.01)


def test_a_centre_of_mass_ahead_of_the_wheels_moves_the_centre_of_rotation():
    ahead = (0.0127, 0.0, 0.06)
    assert gain_and_icr(80, centre_of_mass_m=ahead)[0] == pytest.approx(2.009, rel=0.02)
    # in the limit of slow turning and a tyre that does not fade: the planar balance
    slow = gain_and_icr(
        20,
        centre_of_mass_m=ahead,
        step_s=0.0001,
        tyre={"v0_m_s": 0.003, "rolling": 0.0},
    )
    assert slow == pytest.approx((2.009, 0.02), rel=0.02)
    assert slow == pytest.approx(balance(0.25, 0.31, 1.0, 0.0127), rel=0.02)


def test_grip_across_the_wheels_holds_the_robot_back():
    gain, _ = gain_and_icr(
        80,
        centre_of_mass_m=(0.05, 0.0, 0.06),
        tyre={"mu_long": 0.6, "mu_lat": 0.6 * 2.24},
    )
    assert gain == pytest.approx(1.0, rel=0.05)


def test_left_wheels_forward_turn_the_body_clockwise():
    assert Body().measured(0.5, 3.0, 3.0, -3.0, -3.0)[2] < -0.1
