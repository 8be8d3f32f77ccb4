"""A foreign bag without a mapping: a mapping file is proposed, or the built-in one that fits."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hilserver.commands import main
from hilserver.measured.mapping import load_mapping
from hilserver.measured.proposal import ForeignLog
from hilserver.measured.reading import read_measured
from tests.measured.samples import SQLITE, write_bag

EXAMPLE = Path(__file__).parents[2] / "examples" / "bag"
STORE = get_typestore(Stores.ROS2_HUMBLE)
MOTORS = "robot_msgs/msg/Motors"
STORE.register(
    get_types_from_msg("robot_msgs/Motor[] motors\nfloat32 supply_volt\n", MOTORS)
)
STORE.register(get_types_from_msg("string name\nfloat32 rpm\n", "robot_msgs/msg/Motor"))
TYPES = STORE.types
ZERO = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)


def header():
    stamp = TYPES["builtin_interfaces/msg/Time"](sec=1, nanosec=0)
    return TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id="map")


def pose():
    kinds = "geometry_msgs/msg/"
    return TYPES[kinds + "Pose"](
        TYPES[kinds + "Point"](1.0, 2.0, 0.0),
        TYPES[kinds + "Quaternion"](0.0, 0.0, 0.0, 1.0),
    )


def stamped():
    return TYPES["geometry_msgs/msg/PoseStamped"](header(), pose())


def odometry():
    kinds = "geometry_msgs/msg/"
    twist = TYPES[kinds + "Twist"](ZERO, ZERO)
    return TYPES["nav_msgs/msg/Odometry"](
        header(),
        "base_link",
        TYPES[kinds + "PoseWithCovariance"](pose(), np.zeros(36)),
        TYPES[kinds + "TwistWithCovariance"](twist, np.zeros(36)),
    )


def joints(names, velocity=(), position=()):
    return TYPES["sensor_msgs/msg/JointState"](
        header(),
        list(names),
        np.array(position),
        np.array(velocity),
        np.zeros(len(names)),
    )


def proposed(folder, topics):
    """Return the channels of the proposal for a bag with one message for each topic."""
    with Writer(folder / "bag", version=9, storage_plugin=SQLITE) as writer:
        for name, message in topics.items():
            kind = message.__msgtype__
            connection = writer.add_connection(name, kind, typestore=STORE)
            writer.write(connection, 10**18, STORE.serialize_cdr(message, kind))
    with pytest.raises(ForeignLog) as refusal:
        read_measured([folder / "bag"])
    if not refusal.value.proposal:
        return {}
    (folder / "map.yaml").write_text(refusal.value.proposal)
    channels = load_mapping(folder / "map.yaml").channels
    return {
        signal: (channel.topic, channel.field) for signal, channel in channels.items()
    }


def test_the_proposal_for_the_example_is_the_mapping_that_was_written_for_it(
    tmp_path, monkeypatch, capsys
):
    spec = importlib.util.spec_from_file_location("make_bag", EXAMPLE / "make_bag.py")
    make_bag = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make_bag)
    monkeypatch.chdir(tmp_path)
    make_bag.main(Path("drive"))
    assert main(["diagnose", "drive", "-o", "out"]) == 2
    (sentence,) = capsys.readouterr().err.splitlines()
    assert sentence.endswith("out/mapping.yaml is a first guess: check and complete it")
    wanted = load_mapping(EXAMPLE / "mapping.yaml").channels
    channels = load_mapping(Path("out/mapping.yaml")).channels
    assert channels.keys() == wanted.keys()
    for signal, channel in wanted.items():
        unit = {"imu.gyro_z_rad_s": None}.get(signal, channel.unit)  # the signal's own
        assert channels[signal] == channel.model_copy(update={"unit": unit}), signal
    log = read_measured([Path("drive")], "out/mapping.yaml")
    assert {*wanted} <= {*log.channels}


def test_a_pose_made_of_wheel_speeds_and_goals_stand_behind_a_measured_one(tmp_path):
    topics = {"/goal_pose": stamped(), "/odom": odometry(), "/tracker": stamped()}
    assert proposed(tmp_path, topics)["nav.x_m"] == ("/tracker", "pose.position.x")


def test_a_point_that_somebody_clicked_on_a_map_is_no_measured_position(tmp_path):
    point = TYPES["geometry_msgs/msg/PointStamped"](header(), pose().position)
    assert proposed(tmp_path, {"/clicked_point": point}) == {}
    (tmp_path / "tag").mkdir()
    found = proposed(tmp_path / "tag", {"/clicked_point": point, "/tag": point})
    assert found["nav.x_m"] == ("/tag", "point.x")


def test_odometry_alone_is_proposed_with_a_warning(tmp_path):
    assert proposed(tmp_path, {"/odom": odometry()})["nav.x_m"] == (
        "/odom",
        "pose.pose.position.x",
    )
    (line, *_) = [
        row
        for row in (tmp_path / "map.yaml").read_text().splitlines()
        if "nav.x" in row
    ]
    assert "computed from the wheel speeds?" in line


def test_a_twist_is_a_command_where_its_topic_says_so(tmp_path):
    twist = TYPES["geometry_msgs/msg/Twist"](ZERO, ZERO)
    assert proposed(tmp_path, {"/velocity": twist, "/cmd_vel": twist}) == {
        "twist.linear_m_s": ("/cmd_vel", "linear.x"),
        "twist.angular_rad_s": ("/cmd_vel", "angular.z"),
    }


def test_joints_have_the_speeds_of_their_names_and_no_torques(tmp_path):
    names = ("rear_right_wheel", "front_left_wheel", "arm")
    topics = {
        "/joint_states": joints(
            names, velocity=(1.0, 2.0, 3.0), position=(4.0, 5.0, 6.0)
        )
    }
    assert proposed(tmp_path, topics) == {
        "wheel.fl.speed_rpm": ("/joint_states", "velocity[front_left_wheel]"),
        "wheel.fl.angle_rad": ("/joint_states", "position[front_left_wheel]"),
        "wheel.rr.speed_rpm": ("/joint_states", "velocity[rear_right_wheel]"),
        "wheel.rr.angle_rad": ("/joint_states", "position[rear_right_wheel]"),
    }


def test_bare_arrays_are_wheels_in_order_and_own_types_are_read_by_their_names(
    tmp_path,
):
    layout = TYPES["std_msgs/msg/MultiArrayLayout"]([], 0)
    speeds = TYPES["std_msgs/msg/Float32MultiArray"](
        layout, np.ones(4, dtype=np.float32)
    )
    motor = TYPES["robot_msgs/msg/Motor"]
    motors = TYPES[MOTORS]([motor("left", 1.0), motor("right", 2.0)], 12.0)
    found = proposed(tmp_path, {"/target_rpm": speeds, "/motors": motors})
    assert found["wheel.fr.setpoint_rpm"] == ("/target_rpm", "data[1]")
    assert found["wheel.rl.setpoint_rpm"] == ("/target_rpm", "data[2]")
    assert found["wheel.rl.speed_rpm"] == ("/motors", "motors[left].rpm")
    assert found["battery.voltage_v"] == ("/motors", "supply_volt")


def test_without_a_topic_of_ours_nothing_is_proposed(tmp_path):
    field = TYPES["sensor_msgs/msg/MagneticField"](header(), ZERO, np.zeros(9))
    assert proposed(tmp_path, {"/imu/mag": field}) == {}


def test_the_built_in_mapping_that_fits_is_named(tmp_path):
    with pytest.raises(
        ForeignLog, match="give iotbot with --mapping, which fits"
    ) as refusal:
        read_measured([write_bag(tmp_path / "bag")])
    assert refusal.value.proposal == ""


def test_the_proposal_is_yaml_whatever_topics_are_called(tmp_path):
    twist = TYPES["geometry_msgs/msg/Twist"](ZERO, ZERO)
    found = proposed(tmp_path, {'/a"b: {}/cmd': twist})
    assert found["twist.linear_m_s"] == ('/a"b: {}/cmd', "linear.x")


def transforms(i):
    kinds = "geometry_msgs/msg/"

    def one(parent, child, x):
        stamp = TYPES["builtin_interfaces/msg/Time"](
            sec=1 + i // 500, nanosec=2_000_000 * (i % 500)
        )
        place = TYPES[kinds + "Vector3"](x, 0.0, 0.0)
        turned = TYPES[kinds + "Quaternion"](0.0, 0.0, 0.0, 1.0)
        return TYPES[kinds + "TransformStamped"](
            TYPES["std_msgs/msg/Header"](stamp=stamp, frame_id=parent),
            child,
            TYPES[kinds + "Transform"](place, turned),
        )

    parts = [one("odom", "base_link", 0.1 * i), one("base_link", "imu", 0.2)]
    return TYPES["tf2_msgs/msg/TFMessage"]([one("world", "robot", 0.11 * i), *parts])


def test_a_transform_that_a_tracker_publishes_is_a_pose_with_its_own_stamps(tmp_path):
    kind = "tf2_msgs/msg/TFMessage"
    with Writer(tmp_path / "bag", version=9, storage_plugin=SQLITE) as writer:
        connection = writer.add_connection("/tf", kind, typestore=STORE)
        for i in range(600):
            burst = 10**18 + 40_000_000 * (i // 20)
            writer.write(
                connection, burst + i, STORE.serialize_cdr(transforms(i), kind)
            )
    with pytest.raises(ForeignLog) as refusal:
        read_measured([tmp_path / "bag"])
    proposal = refusal.value.proposal
    assert 'field: "transforms[robot].transform.translation.x"' in proposal
    assert "base_link" not in proposal

    (tmp_path / "map.yaml").write_text("time: {stamp: header}\n" + proposal)
    log = read_measured([tmp_path / "bag"], tmp_path / "map.yaml")
    assert np.diff(log["nav.x_m"].t_s) == pytest.approx(2e-3)


def test_the_pose_of_a_localizer_is_that_of_a_map(tmp_path):
    topics = {"/amcl_pose": stamped(), "/odom": odometry()}
    assert proposed(tmp_path, topics)["nav.x_m"] == ("/amcl_pose", "pose.position.x")
    assert load_mapping(tmp_path / "map.yaml").reference.by == "map"


def test_satellites_stand_before_odometry(tmp_path):
    status = TYPES["sensor_msgs/msg/NavSatStatus"](status=0, service=1)
    fix = TYPES["sensor_msgs/msg/NavSatFix"](
        header(), status, 48.7, 9.1, 300.0, np.zeros(9), 0
    )
    found = proposed(tmp_path, {"/odom": odometry(), "/fix": fix})
    assert found["fix.latitude_deg"] == ("/fix", "latitude")
    assert "nav.x_m" not in found
