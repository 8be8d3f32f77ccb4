"""The law against a kinematic robot with the signs of the frame page."""

import math

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.controller.path import (
    Eight,
    Gains,
    Pose,
    Robot,
    follow,
    wheel_speeds_rpm,
)

STEP_S = 0.02


def move(robot: Robot, pose: Pose, wheels: dict[str, float], slip: float = 1.0) -> Pose:
    """Forward kinematics of spec 1, steps 7 to 11, without the drive's dynamics."""
    left = (wheels["fl"] + wheels["rl"]) / 2 * 2 * math.pi / 60
    right = (wheels["fr"] + wheels["rr"]) / 2 * 2 * math.pi / 60
    v = robot.wheel_radius_m * (left - right) / 2
    om = (
        robot.yaw_sign * robot.wheel_radius_m * robot.k_om_per_m * slip * (left + right)
    )
    lateral = -0.02 * om
    yaw = pose.yaw_rad + om * STEP_S / 2
    x = pose.x_m + (v * math.cos(yaw) - lateral * math.sin(yaw)) * STEP_S
    y = pose.y_m + (v * math.sin(yaw) + lateral * math.cos(yaw)) * STEP_S
    return Pose(x, y, math.remainder(pose.yaw_rad + om * STEP_S, 2 * math.pi))


def drive(robot: Robot, pose: Pose, duration_s: float, slip: float = 1.0):
    eight, gains, s = Eight(), Gains(), 0.0
    for _ in range(round(duration_s / STEP_S)):
        command = follow(eight, robot, gains, s, pose, STEP_S)
        s, pose = command.s, move(robot, pose, command.wheels_rpm, slip)
        yield pose, command


@pytest.mark.parametrize("yaw_sign", [-1, 1])
def test_follows_the_eight(yaw_sign):
    robot = Robot(yaw_sign=yaw_sign)
    steps = list(drive(robot, Pose(0.0, 0.0, 0.0), 60.0))
    settled = steps[len(steps) // 6 :]
    assert max(command.error_m for _, command in settled) < 0.02
    xs, ys = [p.x_m for p, _ in settled], [p.y_m for p, _ in settled]
    assert max(xs) > 1.3
    assert min(xs) < -1.3
    assert max(ys) > 0.6
    assert min(ys) < -0.6
    # An eight crosses its middle in two directions.
    crossings = [
        p.yaw_rad for p, _ in settled if abs(p.x_m) < 0.01 and abs(p.y_m) < 0.1
    ]
    assert max(crossings) - min(crossings) > 0.5


def test_stays_on_the_eight_when_the_floor_turns_differently():
    # Measured K_om of a tile floor against the geometric one (table 5.1): about half.
    steps = list(drive(Robot(), Pose(0.0, 0.0, 0.0), 60.0, slip=0.55))
    assert max(command.error_m for _, command in steps[len(steps) // 4 :]) < 0.15


@settings(max_examples=25, deadline=None)
@given(x=st.floats(-5, 5), y=st.floats(-5, 5), yaw=st.floats(-math.pi, math.pi))
def test_comes_back_from_anywhere(x, y, yaw):
    robot = Robot()
    last = [command for _, command in drive(robot, Pose(x, y, yaw), 40.0)][-1]
    assert last.error_m < 0.05


@given(v=st.floats(-3, 3), om=st.floats(-10, 10))
def test_wheels_are_limited_and_keep_the_curvature(v, om):
    robot = Robot()
    wheels = wheel_speeds_rpm(robot, v, om)
    assert max(map(abs, wheels.values())) <= robot.max_rpm * (1 + 1e-12)
    left, right = wheels["fl"] * math.pi / 30, wheels["fr"] * math.pi / 30
    v_out = robot.wheel_radius_m * (left - right) / 2
    om_out = robot.yaw_sign * robot.wheel_radius_m * robot.k_om_per_m * (left + right)
    assert math.isclose(v_out * om, om_out * v, rel_tol=1e-9, abs_tol=1e-9)


def test_signs_of_the_frame_page():
    forward = wheel_speeds_rpm(Robot(), 0.3, 0.0)
    assert forward["fl"] > 0 > forward["fr"]
    left_turn = wheel_speeds_rpm(Robot(), 0.0, 0.5)
    assert left_turn["fl"] < 0
    assert left_turn["fl"] == left_turn["fr"]


@given(
    st.floats(-10, 10),
    st.floats(-50, 50),
    st.sampled_from([62.0, 80.0, 90.0, 140.0, 89.9999999]),
)
def test_no_wheel_is_asked_for_more_than_its_limit(v_m_s, om_rad_s, max_rpm):
    wheels = wheel_speeds_rpm(Robot(max_rpm=max_rpm), v_m_s, om_rad_s)
    assert all(abs(rpm) <= max_rpm for rpm in wheels.values())
