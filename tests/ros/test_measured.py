"""The real robot's messages: each type as the signals that it measures, and what does not fit."""

import math

import numpy as np
import pytest

from hilserver.ros import measured
from hilserver.ros.measured import IOTBOT, MEASURED_TYPES, Conventions
from hilserver.ros.types import known_types
from hilserver.signals import Ranges, robot_table
from tests.ros.messages import (
    MAKE,
    floats,
    imu,
    joints,
    odometry,
    tagged,
    transforms,
    turned,
)

ORDER = ("fl", "rl", "fr", "rr")
WHEELS = {
    "wheel.fl.speed_rpm": 1.0,
    "wheel.rl.speed_rpm": 2.0,
    "wheel.fr.speed_rpm": 3.0,
}
WHEELS |= {"wheel.rr.speed_rpm": 4.0}
RAD_S = math.tau / 60.0


def how(flavour="iotbot_shield", frame="map", joints=None, **more):
    return Conventions.of(flavour, ORDER, frame, "base_link", joints or {}, **more)


def test_every_reading_gives_inputs_of_the_robot_and_has_a_type():
    table = robot_table(Ranges(100.0, 1.0, 1.0))
    for reading in MEASURED_TYPES.values():
        known_types().prepare(reading.type)
        assert all(f"measured.{signal}" in table for signal in reading.signals)
    assert set(IOTBOT.values()) < set(MEASURED_TYPES)


def test_speeds_of_each_program_have_the_signs_of_the_plant():
    named = {"front_left_rpm": 1.0, "rear_left_rpm": 2.0, "front_right_rpm": 3.0}
    message = MAKE("iotbot_interface/msg/RotationSpeed", **named, rear_right_rpm=4.0)
    assert measured.rotation_speed(how(), message) == WHEELS
    assert measured.array(how("thesis_sil"), floats(1, 2, 3, 4)) == WHEELS
    assert measured.array(how("eduard"), floats(-4, -3, -2, -1)) == WHEELS, (
        "rr, fr, rl, fl"
    )


def test_joints_turn_forward_with_a_positive_sign_but_in_edu_robot():
    named = {
        "front_left_wheel": 1,
        "wheel_rl": 2,
        "base_to_wheel_front_right": -3,
        "x_RR": -4,
    }
    speeds = {name: sign * RAD_S for name, sign in named.items()}
    assert measured.joints(how(), joints(**speeds, camera=9.0)) == pytest.approx(WHEELS)
    edu, gathered = how("eduard"), {}
    for place, rpm in (
        ("rear_right", 4),
        ("front_right", 3),
        ("rear_left", 2),
        ("front_left", 1),
    ):
        assert not gathered, "a speed of one wheel is kept until all have come"
        gathered = measured.joints(
            edu, joints(**{f"base_to_wheel_{place}": -rpm * RAD_S})
        )
    assert gathered == pytest.approx(WHEELS)


@pytest.mark.parametrize(
    ("left", "right", "named"),
    [
        ("wheel_left_joint", "wheel_right_joint", {}),  # TurtleBot 3
        ("left_wheel_joint", "right_wheel_joint", {}),  # iRobot Create 3
        ("base_to_wheel_left", "base_to_wheel_right", {}),  # ours
        ("front_left_wheel", "front_right_wheel", {}),
        ("m0", "m1", {"m0": "rl", "m1": "fr"}),
    ],
)
def test_two_joints_are_all_wheels_of_a_robot_on_one_axle(left, right, named):
    message = joints(**{left: 2.0 * RAD_S, right: 3.0 * RAD_S}, camera_left=9.0)
    found = measured.joints(how(joints=named, is_on_one_axle=True), message)
    sides = {"fl": 2.0, "rl": 2.0, "fr": -3.0, "rr": -3.0}
    speeds = {f"wheel.{wheel}.speed_rpm": rpm for wheel, rpm in sides.items()}
    assert found == pytest.approx(speeds)


@pytest.mark.parametrize(
    ("named", "other"),
    [({}, "wheel_drop"), ({"left_wheel": "fl", "right_wheel": "fr"}, "back_wheel")],
)
def test_what_turns_no_driven_wheel_changes_no_speed(named, other):
    speeds = {"left_wheel": 2.0, "right_wheel": 3.0}
    others = {f"{other}_left_joint": 0.0, f"{other}_right_joint": 0.0}
    robot = how(joints=named, is_on_one_axle=True)
    found = measured.joints(robot, joints(**speeds, **others))
    assert found == measured.joints(robot, joints(**speeds))


def test_joints_that_name_no_wheel_are_told_and_can_be_named():
    speeds = {f"m{i}": 2.0 * RAD_S for i in range(4)}
    plain = how()
    assert measured.joints(plain, joints(**speeds)) == {}
    (told,) = plain.remarks
    assert "ros2.measured.joints" in told
    found = measured.joints(
        how(joints=dict(zip(speeds, ORDER, strict=True))), joints(**speeds)
    )
    assert (
        found["wheel.fl.speed_rpm"]
        == -found["wheel.fr.speed_rpm"]
        == pytest.approx(2.0)
    )


def test_an_imu_gives_what_it_measures():
    whole = measured.imu(how(), imu())
    assert whole == pytest.approx(
        dict(zip(measured.INERTIAL, (0.2, 0.5, 0.3, -0.4), strict=True))
    )
    for absent, signals in (
        ("rate", {"imu.gyro_z_rad_s"}),
        ("orientation", {"imu.yaw_rad"}),
        ("force", {"imu.accel_x_m_s2", "imu.accel_y_m_s2"}),
    ):
        assert (
            measured.imu(how(), imu(unmeasured=[absent])).keys()
            == whole.keys() - signals
        )
    assert "imu.yaw_rad" not in measured.imu(
        how(), imu(orientation=turned(0.0, norm=0.0))
    )


def test_poses_count_in_one_frame():
    message = tagged(1, 2, 0.5, "/map")
    assert list(measured.tag(how(), message).values()) == pytest.approx([1.0, 2.0, 0.5])
    other = how(frame="hall")
    assert measured.tag(other, message) == {}
    assert list(other.remarks) == [
        "gives poses in 'map', which is not ros2.measured.frame 'hall'"
    ]
    wheels = measured.odometry(how(), odometry("odom"))
    assert wheels == dict(zip(measured.TWIST, (0.3, 0.1, 0.7), strict=True))
    located = measured.odometry(how(frame="odom"), odometry("odom"))
    assert [located[name] for name in measured.POSE] == pytest.approx([1.0, 2.0, 0.5])


def test_transforms_lead_along_the_frames_between():
    tree = how()
    assert (
        measured.transforms(tree, transforms(("base_link", "imu_link", 0, 0, 0))) == {}
    )
    assert list(tree.remarks) == [
        "has no frame 'base_link', which is ros2.measured.base_frame"
    ]
    tree.remarks.clear()
    assert measured.transforms(tree, transforms(("odom", "base_link", 1, 0, 0.5))) == {}
    (told,) = tree.remarks
    assert told.startswith("leads from 'base_link' to 'odom'")
    message = transforms(("map", "odom", 3, 4, math.pi / 2))
    found = measured.transforms(tree, message)
    assert list(found.values()) == pytest.approx([3.0, 5.0, math.pi / 2 + 0.5])
    assert (
        measured.transforms(tree, transforms(("base_link", "imu_link", 0, 0, 0))) == {}
    )
    assert measured.stamp_ns(message) == 7


def test_frames_in_a_circle_lead_nowhere():
    tree = how()
    links = transforms(("odom", "base_link", 0, 0, 0), ("base_link", "odom", 0, 0, 0))
    assert measured.transforms(tree, links) == {}


@pytest.mark.parametrize(
    ("read", "message", "said"),
    [
        (
            measured.array,
            floats(1, 2, 3),
            "3 numbers instead of one for each of four wheels",
        ),
        (
            measured.imu,
            imu(orientation=turned(0.5, norm=2.0)),
            "quaternion of norm 2 instead of 1",
        ),
        (
            measured.transforms,
            transforms(("map", "base_link", 0, 0, math.nan)),
            "norm nan",
        ),
    ],
)
def test_what_does_not_fit_is_one_sentence(read, message, said):
    with pytest.raises(ValueError, match=said):
        read(how(), message)


def test_velocities_without_their_joints():
    message = joints(front_left=1.0)
    message.velocity = np.zeros(0)
    with pytest.raises(ValueError, match="0 velocities for 1 joints"):
        measured.joints(how(), message)
