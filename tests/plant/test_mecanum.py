"""Mecanum wheels: signs, closed-form drives, what is refused."""

import math

import numpy as np
import pytest

from hilserver.plant.errors import PlantError
from hilserver.plant.parameters import RobotParameters
from tests.plant.rig import Rig

GEOMETRY = {
    "drive": "mecanum",
    "wheel_radius_m": 0.05,
    "wheelbase_m": 0.25,
    "track_m": 0.36,
    "icr_offset_m": 0.0,
}
SKID = {"drive": "skid"}
RPM = 60.0 / (2.0 * math.pi)
LEVER_M = 0.5 * (0.25 + 0.36)


def wheels_of(v, vy, om, r=0.05):
    """The contract's four lines, right-handed, in rad/s."""
    return np.array(
        [
            (v - vy - LEVER_M * om) / r,
            (v + vy - LEVER_M * om) / r,
            -(v + vy + LEVER_M * om) / r,
            -(v - vy + LEVER_M * om) / r,
        ]
    )


def rig(**changes):
    return Rig(**GEOMETRY | changes)


def rolling(v, vy, om, **changes):
    """A robot in steady motion: nothing of the drive moves any more."""
    robot = rig(max_rpm=1000.0, **changes)
    rpm = wheels_of(v, vy, om) * RPM
    robot.x.speed = robot.x.motor = rpm
    robot.x.integral = rpm / robot.robot.process.gain
    return robot.wheels(*rpm)


@pytest.mark.parametrize(
    ("twist", "signs"),
    [
        ((0.2, 0.0, 0.0), (1, 1, -1, -1)),  # forward
        ((0.0, 0.2, 0.0), (-1, 1, -1, 1)),  # to the left
        ((0.0, -0.2, 0.0), (1, -1, 1, -1)),  # to the right
        ((0.0, 0.0, 0.5), (-1, -1, -1, -1)),  # turns left
    ],
)
def test_a_twist_turns_the_wheels_as_the_contract_says(twist, signs):
    v, vy, om = twist
    robot = rig().twist(v, om)
    robot.u.twist_lateral = vy
    commanded = robot.step().x.commanded
    assert tuple(np.sign(commanded)) == signs
    assert commanded == pytest.approx(wheels_of(*twist) * RPM, abs=1e-9)


@pytest.mark.parametrize(
    "twist",
    [
        (0.0, 0.3, 0.0),
        (0.2, 0.2, 0.0),
        (0.0, 0.0, 1.0),
        (0.25, -0.1, 0.7),
        (-0.1, 0.15, -0.8),
    ],
)
def test_a_steady_drive_ends_where_the_closed_form_says(twist):
    v, vy, om = twist
    robot, seconds = rolling(*twist).step(2000), 2.0
    assert robot.velocity == pytest.approx(twist, abs=1e-9)
    turned = om * seconds
    chord = seconds * (math.sin(turned / 2) / (turned / 2) if om else 1.0)
    x = chord * (v * math.cos(turned / 2) - vy * math.sin(turned / 2))
    y = chord * (v * math.sin(turned / 2) + vy * math.cos(turned / 2))
    assert robot.pose == pytest.approx(
        (x, y, math.remainder(turned, 2 * math.pi)), abs=1e-9
    )


def test_rollers_that_slip_take_a_share_of_the_speed_to_the_side_alone():
    twist = (0.2, 0.2, 0.5)
    firm, slipping = (
        rolling(*twist, terms={"roller_slip": slip}).step(500) for slip in (0.0, 0.25)
    )
    assert slipping.velocity[1] == pytest.approx(0.75 * firm.velocity[1])
    assert slipping.velocity[[0, 2]].tobytes() == firm.velocity[[0, 2]].tobytes()
    assert slipping.pose[2] == firm.pose[2]


def test_the_wheels_left_alone_reach_the_commanded_twist():
    robot = rig().twist(0.1, 0.2)
    robot.u.twist_lateral = 0.1
    assert robot.step(3000).velocity == pytest.approx((0.1, 0.1, 0.2), abs=1e-6)


def test_too_fast_a_twist_keeps_its_direction():
    robot = rig().twist(0.4, 0.0)
    robot.u.twist_lateral = 0.4
    v, vy, om = robot.step(3000).velocity
    assert v == pytest.approx(vy)
    assert om == pytest.approx(0.0, abs=1e-9)
    assert v == pytest.approx(90.0 / RPM * 0.05 / 2.0, rel=1e-6)


def test_acceleration_sideways_is_the_derivative_of_the_speed():
    robot, dt = rig().twist(0.0, 0.0), 0.001
    robot.u.twist_lateral = 0.2
    robot.step(20)
    speed, shown = robot.velocity[1], robot.x.accel_y
    robot.step()
    assert (robot.velocity[1] - speed) / dt == pytest.approx(
        0.5 * (shown + robot.x.accel_y), rel=1e-2
    )


def test_a_skid_steer_robot_ignores_the_lateral_twist():
    plain, asked = Rig().twist(0.1, 0.2), Rig().twist(0.1, 0.2)
    asked.u.twist_lateral = 0.3
    assert plain.step(100).x.tobytes() == asked.step(100).x.tobytes()


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        (
            {"terms": {"friction_anisotropy": 2.0}},
            "plant.terms.friction_anisotropy.ratio",
        ),
        ({"terms": {"side_slip": 0.1}}, "plant.terms.side_slip"),
        (SKID | {"terms": {"roller_slip": 0.1}}, "plant.terms.roller_slip"),
        ({"icr_offset_m": 0.02}, "plant.icr_offset_m"),
        ({"wheelbase_m": None}, "plant.wheelbase_m"),
        ({"rotation_gain": "tile"}, "kinematics.rotation_gain"),
        ({"drive": "omni"}, "plant.drive"),
    ],
)
def test_what_has_no_meaning_is_refused_by_name(changes, key):
    with pytest.raises(PlantError, match=f"^{key}: "):
        RobotParameters(**GEOMETRY | changes)


def test_the_gain_is_that_of_the_rollers():
    assert RobotParameters(**GEOMETRY).k_om == 1.0 / 0.61
