"""The robot as messages see it: what its wheels make, on tyres and on rollers."""

import math

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.ros2_node import shape_of
from hilserver.plant.layout import WHEELS
from hilserver.ros import outgoing
from hilserver.ros.robot import Odometer, Robot
from hilserver.ros.types import Types


def robot_with(drive, rpm=(0.0,) * 4):
    shape = shape_of(assemble_config(Config.model_validate({"plant": {"drive": drive}})))
    robot = Robot(Types(), shape, Odometer(shape))
    robot.values = {f"wheel.{w}.speed_rpm": v for w, v in zip(WHEELS, rpm, strict=True)}
    robot.values["drive.enable"] = 1.0
    return robot


def test_rollers_take_the_odometry_to_the_left():
    robot, way = robot_with("mecanum", (-30.0, 30.0, -30.0, 30.0)), 0.05 * math.pi
    for share in (0.0, 0.25, 0.5):
        angles = (-share, share, -share, share)
        robot.odometer.see(
            {f"wheel.{w}.angle_rad": math.tau * a for w, a in zip(WHEELS, angles, strict=True)}
        )
    assert (robot.odometer.x_m, robot.odometer.y_m) == pytest.approx((0.0, way))
    assert robot.twist() == pytest.approx((0.0, way, 0.0))
    assert robot_with("skid", (-30.0, 30.0, -30.0, 30.0)).twist() == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("drive", "kind", "aside"), [("mecanum", 2, (-1, 1, -1, 1)), ("skid", 1, (0, 0, 0, 0))]
)
def test_the_kinematics_are_those_of_edu_robot(drive, kind, aside):
    """Rows RR FR RL FL, times 1/r: [+-1, aside, s] (the source of edu_robot)."""
    robot = robot_with(drive)
    (message,) = outgoing.kinematic_description(robot)
    r, ly = robot.shape.wheel_radius_m, robot.shape.track_m
    lx = robot.shape.wheelbase_m
    s = 0.5 * (lx + ly) if drive == "mecanum" else (lx**2 + ly**2) / (2.0 * ly)
    rows = np.column_stack([(1, 1, -1, -1), aside, (s,) * 4]) / r
    np.testing.assert_allclose(message.k.data.reshape(4, 3), rows, rtol=1e-6)
    assert outgoing.mode(robot).drive_kinematic == kind
