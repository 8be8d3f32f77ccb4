"""The robot as messages see it: what its wheels make, on tyres and on rollers."""

import math
from xml.etree import ElementTree

import numpy as np
import pytest

from hilserver.body.export import robot_urdf
from hilserver.body.parameters import BodyParameters
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.ros import outgoing
from hilserver.ros.flavours import FLAVOURS
from hilserver.ros.robot import Odometer, RosFrame, Shape
from hilserver.ros.types import Types


def robot_with(drive, rpm=(0.0,) * 4, **plant):
    plant = {"drive": drive, **plant}
    assembly = assemble_config(Config.model_validate({"plant": plant}))
    shape = Shape.of(assembly.robot, assembly.composition.parameters)
    robot = RosFrame(Types(), shape, Odometer(shape))
    robot.values = {f"wheel.{w}.speed_rpm": v for w, v in zip(WHEELS, rpm, strict=True)}
    robot.values |= {
        f"wheel.{w}.angle_rad": v for w, v in zip(WHEELS, rpm, strict=True)
    }
    robot.values["drive.enable"] = 1.0
    return robot


ONE_AXLE = {"wheelbase_m": None, "icr_offset_m": 0.0}


@pytest.mark.parametrize("plant", [{}, ONE_AXLE], ids=["four_wheels", "two_wheels"])
@pytest.mark.parametrize("make", [outgoing.joint_states, outgoing.wheel_states])
def test_joints_are_those_of_the_urdf(plant, make):
    robot = robot_with("skid", **plant)
    body = BodyParameters(robot=RobotParameters(**plant))
    joints = ElementTree.fromstring(robot_urdf(body)).findall("joint")
    turning = {j.get("name") for j in joints if j.get("type") == "continuous"}
    assert {name for message in make(robot) for name in message.name} == turning


@pytest.mark.parametrize("plant", [{}, ONE_AXLE], ids=["four_wheels", "two_wheels"])
def test_wheels_that_roll_forward_are_positive_joints(plant):
    """As REP-103 has it; the plant and edu_robot mirror one side."""
    (message,) = outgoing.wheel_states(robot_with("skid", (60, 60, -60, -60), **plant))
    assert (message.position == 60.0).all()
    assert message.velocity == pytest.approx(np.full(len(message.name), math.tau))


def test_rollers_take_the_odometry_to_the_left():
    robot, way = robot_with("mecanum", (-30.0, 30.0, -30.0, 30.0)), 0.05 * math.pi
    for share in (0.0, 0.25, 0.5):
        angles = (-share, share, -share, share)
        robot.odometer.see(
            {
                f"wheel.{w}.angle_rad": math.tau * a
                for w, a in zip(WHEELS, angles, strict=True)
            }
        )
    assert (robot.odometer.x_m, robot.odometer.y_m) == pytest.approx((0.0, way))
    assert robot.twist() == pytest.approx((0.0, way, 0.0))
    assert robot_with("skid", (-30.0, 30.0, -30.0, 30.0)).twist() == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("drive", "kind", "aside"),
    [("mecanum", 2, (-1, 1, -1, 1)), ("skid", 1, (0, 0, 0, 0))],
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


def test_odometry_carries_covariances_that_grow_with_the_way():
    robot, deviations = robot_with("skid", (30.0, 30.0, -30.0, -30.0)), []
    for turns in (0.0, 0.4, 0.8, 1.2):
        angle = math.tau * turns
        robot.odometer.see({f"wheel.{w}.angle_rad": angle * (1 if w in ("fl", "rl") else -1)
                            for w in WHEELS})  # fmt: skip
        (message,) = outgoing.odometry(robot)
        pose = message.pose.covariance.reshape(6, 6)
        np.testing.assert_array_equal(pose, np.diag(np.diag(pose)))
        assert np.diag(pose)[2:5].tolist() == [1e6] * 3
        assert (message.twist.covariance.reshape(6, 6).diagonal() > 0.0).all()
        deviations.append(math.sqrt(pose[0, 0]))
    way_m = 1.2 * math.tau * robot.shape.wheel_radius_m
    assert deviations[-1] == pytest.approx(0.001 + 0.02 * way_m)
    assert deviations == sorted(set(deviations))
    robot.odometer.reset()
    (message,) = outgoing.odometry(robot)
    assert message.pose.covariance[0] == pytest.approx(1e-6)


@pytest.mark.parametrize("name", FLAVOURS)
def test_the_service_that_enables_the_drive_is_one_of_the_flavour(name):
    flavour = FLAVOURS[name]
    assert flavour.enabled_by in {"", *(served.name for served in flavour.served)}
    assert bool(flavour.enabled_by) == bool(flavour.served)


def test_the_estimate_carries_its_covariances_and_is_silent_before_a_fix():
    robot = robot_with("skid")
    assert list(outgoing.estimate(robot)) == []
    numbers = {"x_m": 1.0, "y_m": 2.0, "yaw_rad": math.pi / 2, "linear_m_s": 0.4}
    numbers |= {"angular_rad_s": 0.3, "x_m_sd": 0.1, "y_m_sd": 0.2, "yaw_rad_sd": 0.05}
    numbers |= {"linear_m_s_sd": 0.01, "angular_rad_s_sd": 0.02}
    numbers |= {"x_y_cov": 0.006, "x_yaw_cov": 0.001, "y_yaw_cov": -0.002, "state": 0.0}
    robot.values |= {f"estimate.{name}": value for name, value in numbers.items()}
    assert list(outgoing.estimate(robot)) == []
    robot.values["estimate.state"] = 2.0
    (message,) = outgoing.estimate(robot)
    assert message.header.frame_id == "map"
    assert (message.pose.pose.position.x, message.pose.pose.position.y) == (1.0, 2.0)
    assert message.pose.pose.orientation.z == pytest.approx(math.sin(math.pi / 4))
    pose = message.pose.covariance.reshape(6, 6)
    np.testing.assert_array_equal(pose, pose.T)
    assert pose[[0, 1, 5], [0, 1, 5]] == pytest.approx([0.01, 0.04, 0.0025])
    assert (pose[0, 1], pose[0, 5], pose[1, 5]) == (0.006, 0.001, -0.002)
    twist = message.twist.covariance.reshape(6, 6).diagonal()
    assert twist[[0, 5]] == pytest.approx([1e-4, 4e-4])
    assert (message.twist.twist.linear.x, message.twist.twist.angular.z) == (0.4, 0.3)
