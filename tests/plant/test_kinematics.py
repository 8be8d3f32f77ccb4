"""Pose and velocity: closed forms, signs, wrap, the thesis's numbers."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.plant.parameters import Controller, Process, RobotParameters
from hilserver.plant.pose import wrap
from tests.plant.rig import Rig

RAD = 2 * math.pi / 60


def test_left_forward_and_right_backward_turns_clockwise():
    """In the robot's own wheel signs both are positive, for the right wheels are mirrored."""
    rig = Rig().wheels(20, 20, 20, 20).drive(500)
    assert rig.velocity[2] < 0
    assert rig.pose[2] < -0.1
    assert rig.y.gyro < 0
    assert rig.y.heading < -0.1


def test_positive_twist_turns_counter_clockwise():
    rig = Rig().twist(0.0, 0.5).drive(1000)
    assert rig.velocity[2] == pytest.approx(0.5, rel=1e-6)
    assert 0.4 < rig.pose[2] < 0.5


def test_forward_is_left_positive_right_negative():
    rig = Rig(icr_offset_m=0.0).wheels(40, 40, -40, -40).step(1000)
    assert rig.velocity.tolist() == pytest.approx([0.085 * 40 * RAD, 0, 0], abs=1e-7)
    assert rig.pose[0] > 0.2
    assert rig.pose[1] == 0.0


def test_yaw_sign_of_the_print():
    rig = Rig(yaw_sign=1).wheels(20, 20, 20, 20).step(500)
    assert rig.velocity[2] > 0


def test_lateral_velocity_comes_from_the_centre_of_rotation():
    """A robot that turns left about a point ahead of the centre of mass sweeps it to the right."""
    rig = Rig().twist(0.0, 1.0).step(1000)
    assert rig.velocity[1] == pytest.approx(-0.02 * rig.velocity[2], rel=1e-12)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("geometric_skid", 0.31 / (0.25**2 + 0.31**2)),
        ("geometric_skid", 1.9546),
        ("geometric_diff", 3.2258),
        ("printed_5_21", 3.229),
        ("printed_5_22", 1.995),
        ("tile", 1.052),
        ("floating_floor", 1.019),
        ("carpet_hard", 1.036),
        ("carpet_soft", 1.030),
        ("steady", 1.12),
        (1.5, 1.5),
    ],
)
def test_k_om_by_name(name, value):
    assert RobotParameters(rotation_gain=name).k_om == pytest.approx(value, abs=5e-5)


def test_printed_values_need_an_l_x_that_rounds_to_0_24():
    lx, ly = 0.2436, 0.3097
    assert 1 / ly == pytest.approx(3.229, abs=5e-4)
    assert ly / (lx**2 + ly**2) == pytest.approx(1.995, abs=5e-4)


@pytest.mark.parametrize("yaw_sign", [-1, 1])
@pytest.mark.parametrize("gain", ["geometric_skid", "tile"])
@pytest.mark.parametrize(("v", "om"), [(0.2, 0.0), (0.0, 0.7), (0.25, -0.4)])
def test_inverse_kinematics_meets_the_twist(yaw_sign, gain, v, om):
    """(5.25) is the inverse of (5.5) to (5.7) for every nominal robot."""
    rig = Rig(yaw_sign=yaw_sign, rotation_gain=gain).twist(v, om).step(3000)
    assert rig.velocity[[0, 2]].tolist() == pytest.approx([v, om], abs=1e-9)


def test_inverse_kinematics_stays_nominal_under_terms():
    plain, changed = Rig(), Rig(terms={"wheel_radius": 0.1, "rotation_gain": -0.4})
    for rig in (plain, changed):
        rig.twist(0.2, 0.3).step()
    assert np.array_equal(plain.x.setpoint, changed.x.setpoint)


def test_straight_line_meets_closed_form():
    rig = Rig(icr_offset_m=0.0).rolling(50.0, -50.0)
    rig.x.pose[2] = 0.7
    rig.step(20_000)
    length = 0.085 * 50 * RAD * 20.0
    assert rig.pose.tolist() == pytest.approx(
        [length * math.cos(0.7), length * math.sin(0.7), 0.7], abs=1e-9
    )


@pytest.mark.parametrize(
    ("left", "right"), [(60.0, -40.0), (30.0, 30.0), (-20.0, -45.0)]
)
def test_circle_meets_closed_form(left, right):
    rig = Rig().rolling(left, right)
    seconds = 20.0
    rig.step(round(seconds * 1000))
    k_om = 0.31 / (0.25**2 + 0.31**2)
    om = -0.085 * k_om * (left + right) * RAD
    v, vy = 0.085 * (left - right) * RAD / 2, -0.02 * om
    turned = om * seconds
    x = (v * math.sin(turned) - vy * (1 - math.cos(turned))) / om
    y = (v * (1 - math.cos(turned)) + vy * math.sin(turned)) / om
    assert rig.pose[:2].tolist() == pytest.approx([x, y], abs=1e-9)
    assert math.remainder(rig.pose[2] - turned, 2 * math.pi) == pytest.approx(
        0.0, abs=1e-9
    )


def test_large_turn_per_tick_leaves_the_series():
    """4 rad per tick: sin(h)/h is evaluated as it stands."""
    fast = {
        "controller": Controller(k_p=0.13513, k_i=1.9584),
        "process": Process(gain=111.0),
    }
    rig = Rig(period_s=0.014, max_rpm=1e4, **fast).rolling(9000.0, 9000.0).step()
    om = -0.085 * rig.robot.k_om * 18000 * RAD
    vy = -0.02 * om
    turned = om * 0.014
    assert abs(turned) > 3
    assert rig.pose[0] == pytest.approx(-vy * (1 - math.cos(turned)) / om, rel=1e-9)


# --- wrap ---------------------------------------------------------------------------------------


def ulps(value, count):
    for _ in range(abs(count)):
        value = math.nextafter(value, math.inf if count > 0 else -math.inf)
    return value


@given(st.integers(-2000, 2000), st.integers(-40, 40))
def test_wrap_near_odd_multiples_of_pi(turns, away):
    angle = ulps((2 * turns + 1) * math.pi, away)
    once = wrap(angle)
    assert -math.pi < once <= math.pi
    assert wrap(once) == once
    assert math.remainder(angle - once, 2 * math.pi) == pytest.approx(0, abs=1e-11)


@given(st.floats(-math.pi, math.pi, exclude_min=True))
def test_wrap_keeps_every_bit_inside(angle):
    assert np.float64(wrap(angle)).tobytes() == np.float64(angle).tobytes()


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_wrap_lies_inside_for_every_double(angle):
    assert -math.pi < wrap(angle) <= math.pi


def test_wrap_examples():
    assert wrap(-math.pi) == math.pi
    assert wrap(math.pi) == math.pi
    assert math.copysign(1.0, wrap(-0.0)) == -1.0
    assert wrap(3 * math.pi) == math.pi
    assert math.isnan(wrap(math.nan))


def test_yaw_stays_wrapped_while_spinning():
    rig = Rig().rolling(-80.0, -80.0)
    yaws = [rig.step().y.pose[2] for _ in range(4000)]
    assert min(yaws) > -math.pi
    assert max(yaws) <= math.pi
    assert np.count_nonzero(np.diff(yaws) < -3) == int(
        (sum(np.diff(np.unwrap(yaws))) + math.pi) // (2 * math.pi)
    )
