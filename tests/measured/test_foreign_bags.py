"""Bags of other recorders: their own definitions, several publishers, every container."""

import contextlib
import json
import sqlite3
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hilserver.errors import LogError
from hilserver.measured.reading import read_measured
from tests.measured.samples import MCAP, SQLITE, bag_file, write_bag

SPEED = "wheel.fl.speed_rpm"
JOINTS = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
NAMES = ["front_left_joint", "front_right_joint"]


def at(i):
    return 1_700_000_000_000_000_000 + i * 20_000_000


def store():
    return get_typestore(Stores.ROS2_HUMBLE)


def header(types, i):
    stamp = types["builtin_interfaces/msg/Time"](
        sec=at(i) // 10**9, nanosec=at(i) % 10**9
    )
    return types["std_msgs/msg/Header"](stamp=stamp, frame_id="base_link")


def write(path, messages, storage=SQLITE, types=None, compression=None):
    """Write a bag of (topic, type, stamp, message)."""
    types, connections = types or store(), {}
    writer = Writer(path, version=9, storage_plugin=storage)
    if compression is not None:
        writer.set_compression(compression, CompressionFormat.ZSTD)
    with writer:
        for topic, kind, stamp, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=types)
            writer.write(connections[topic], stamp, types.serialize_cdr(message, kind))
    return path


def joints(i, names, velocity, topic="/joint_states"):
    types = store().types
    message = types[JOINTS](
        header=header(types, i),
        name=list(names),
        position=np.zeros(len(names)),
        velocity=np.array(velocity, dtype=float),
        effort=np.zeros(0),
    )
    return topic, JOINTS, at(i), message


def odometry(i, quaternion=(0.0, 0.0, 0.0, 1.0)):
    types = store().types
    g = "geometry_msgs/msg/"
    zero = types[g + "Vector3"](0.0, 0.0, 0.0)
    pose = types[g + "Pose"](
        types[g + "Point"](0.1 * i, 0.0, 0.0), types[g + "Quaternion"](*quaternion)
    )
    return (
        "/odom",
        ODOMETRY,
        at(i),
        types[ODOMETRY](
            header(types, i),
            "base_link",
            types[g + "PoseWithCovariance"](pose, np.zeros(36)),
            types[g + "TwistWithCovariance"](
                types[g + "Twist"](zero, zero), np.zeros(36)
            ),
        ),
    )


def measured(folder, path, **channels):
    """Read through a mapping of signal (with _ for .) to topic and field."""
    time = channels.pop("stamp", None)
    lines = ["time: {stamp: header}"] if time else []
    lines.append("channels:")
    for signal, (topic, field) in channels.items():
        name = {"speed": SPEED, "right": "wheel.fr.speed_rpm"}.get(
            signal, f"nav.{signal}"
        )
        lines.append(f'  {name}: {{topic: {topic}, field: "{field}"}}')
    (folder / "map.yaml").write_text("\n".join(lines) + "\n")
    return read_measured([path], folder / "map.yaml")


RANGE = """std_msgs/Header header
uint8 radiation_type
float32 field_of_view
float32 min_range
float32 max_range
float32 range
float32 variance
"""


@pytest.mark.parametrize("storage", [SQLITE, MCAP])
def test_the_definition_in_the_bag_comes_before_that_of_the_distribution(
    tmp_path, storage
):
    """A Range of Jazzy has a variance; and whoever changed a standard type has another yet."""
    jazzy = get_typestore(Stores.ROS2_JAZZY)
    t = jazzy.types
    kind = "sensor_msgs/msg/Range"
    messages = [
        ("/range", kind, at(i), t[kind](header(t, i), 0, 0.1, 0.2, 4.0, 0.01 * i, 0.5))
        for i in range(100)
    ]
    bag = write(tmp_path / "bag", messages, storage, jazzy)
    log = measured(tmp_path, bag, x_m=("/range", "range"), y_m=("/range", "variance"))
    assert log["nav.x_m"].values == pytest.approx([0.01 * i for i in range(100)])
    assert set(log["nav.y_m"].values) == {0.5}


def damage_definition(bag, kind, text):
    connection = sqlite3.connect(bag_file(bag))
    connection.execute(
        "UPDATE message_definitions SET encoded_message_definition = ? WHERE topic_type = ?",
        (text, kind),
    )
    connection.commit()
    connection.close()


def test_a_definition_that_fails_costs_its_topic_not_the_bag(tmp_path):
    own = get_typestore(Stores.ROS2_HUMBLE)
    own.register(get_types_from_msg("float64 value\n", "acme/msg/Speed"))
    own.register(get_types_from_msg("float64 value\n", "acme/msg/Other"))
    kinds = ("acme/msg/Speed", "acme/msg/Other")
    messages = [
        (f"/{k[9:].lower()}", k, at(i), own.types[k](float(i)))
        for k in kinds
        for i in range(100)
    ]
    bag = write(tmp_path / "bag", messages, types=own)
    damage_definition(bag, "acme/msg/Other", "float64 [broken")
    fields = {"speed": ("/speed", "value"), "x_m": ("/other", "value")}
    log = measured(tmp_path, bag, **fields)
    assert log[SPEED].values.tolist() == list(range(100))
    assert "nav.x_m" not in log
    assert any(
        "topic '/other': the definition of its type 'acme/msg/Other'" in n
        for n in log.notices
    )
    with pytest.raises(LogError, match="topic '/other': the definition of its type"):
        measured(tmp_path, bag, x_m=("/other", "value"))


def test_where_the_definition_fails_that_of_the_distribution_may_do(tmp_path):
    bag = write(tmp_path / "bag", [odometry(i) for i in range(100)])
    damage_definition(bag, ODOMETRY, "Foo/Bar/Baz[ x\n")
    log = measured(tmp_path, bag, x_m=("/odom", "pose.pose.position.x"))
    assert len(log["nav.x_m"]) == 100
    assert "that of ROS 2 Humble is used" in log.notices[0]


def test_messages_with_a_shorter_list_are_no_samples_and_counted(tmp_path):
    """A gripper's publisher without velocities, or with an arm of other joints."""
    messages = [joints(2 * i, NAMES, [i, -i]) for i in range(100)]
    messages += [joints(2 * i + 1, ["gripper"], []) for i in range(30)]
    bag = write(tmp_path / "bag", sorted(messages, key=lambda m: m[2]))
    for field in ("velocity[0]", f"velocity[{NAMES[0]}]"):
        log = measured(tmp_path, bag, speed=("/joint_states", field))
        assert log[SPEED].values.tolist() == list(range(100))
        assert "30 of 130 messages contain no sample" in log.notices[0]


def test_joints_are_found_by_their_names_in_any_order(tmp_path):
    messages = [
        joints(i, NAMES[::-1] if i % 2 else NAMES, [-i, i] if i % 2 else [i, -i])
        for i in range(100)
    ]
    bag = write(tmp_path / "bag", messages, MCAP)
    fields = {"speed": f"velocity[{NAMES[0]}]", "right": f"velocity[{NAMES[1]}]"}
    log = measured(
        tmp_path, bag, **{k: ("/joint_states", f) for k, f in fields.items()}
    )
    assert log[SPEED].values.tolist() == list(range(100))
    assert log["wheel.fr.speed_rpm"].values.tolist() == [-i for i in range(100)]
    with pytest.raises(
        LogError, match=r"'velocity\[0\]' is 'front_left_joint' in some messages and"
    ):
        measured(tmp_path, bag, speed=("/joint_states", "velocity[0]"))
    with pytest.raises(
        LogError, match=r"no 'front_lefd_joint'; did you mean 'front_left_joint'\?"
    ):
        measured(tmp_path, bag, speed=("/joint_states", "velocity[front_lefd_joint]"))


def frame(i, name, x):
    types, g = store().types, "geometry_msgs/msg/"
    transform = types[g + "Transform"](
        types[g + "Vector3"](x, 0.0, 0.0), types[g + "Quaternion"](0.0, 0.0, 0.0, 1.0)
    )
    return types[g + "TransformStamped"](header(types, i), name, transform)


def test_transforms_are_found_by_their_frames(tmp_path):
    types, kind = store().types, "tf2_msgs/msg/TFMessage"
    messages = []
    for i in range(100):
        frames = [frame(i, "base_link", 0.1 * i), frame(i, "camera", 9.0)]
        frames = frames[::-1] if i % 3 else frames
        messages.append(
            ("/tf", kind, at(i), types[kind](frames[: 1 if i == 50 else 2]))
        )
    bag = write(tmp_path / "bag", messages)
    x = "transforms[{}].transform.translation.x"
    log = measured(tmp_path, bag, x_m=("/tf", x.format("base_link")))
    assert set(np.diff(log["nav.x_m"].values).round(6)) <= {0.1, 0.2}
    with pytest.raises(LogError, match="select it by name, as transforms"):
        measured(tmp_path, bag, x_m=("/tf", x.format(0)))


def test_a_transform_has_the_stamp_of_its_own_header(tmp_path):
    """Other frames in the message have other clocks, and a list may be empty."""
    types, kind = store().types, "tf2_msgs/msg/TFMessage"
    sent = [
        [frame(300 - i, "odom", 0.0), frame(i, "robot", 0.1 * i)] for i in range(100)
    ]
    sent[40], sent[50] = [], [frame(0, "odom", 0.0)]
    messages = [
        ("/tf", kind, at(i), types[kind](list_)) for i, list_ in enumerate(sent)
    ]
    bag = write(tmp_path / "bag", messages)
    x = "transforms[robot].transform.translation.x"
    log = measured(tmp_path, bag, stamp=True, x_m=("/tf", x))
    x_m = log["nav.x_m"]
    assert len(x_m) == 98
    assert x_m.values == pytest.approx(0.1 * x_m.t_s / 0.02, abs=1e-6)


def test_a_quaternion_that_is_none_is_no_heading(tmp_path):
    quaternions = {
        5: (0.0, 0.0, 0.0, 0.0),
        6: (0.0, 0.0, 3.0, 1.0),
        7: (np.nan, 0.0, 0.0, 1.0),
    }
    turned = (0.0, 0.0, float(np.sin(0.1)), float(np.cos(0.1)))
    bag = write(
        tmp_path / "bag", [odometry(i, quaternions.get(i, turned)) for i in range(100)]
    )
    log = measured(
        tmp_path,
        bag,
        x_m=("/odom", "pose.pose.position.x"),
        yaw_rad=("/odom", "pose.pose.orientation.yaw"),
    )
    assert len(log["nav.x_m"]) == 100
    assert log["nav.yaw_rad"].values == pytest.approx([0.2] * 97)
    assert "3 of 100 messages contain no sample: the quaternion" in log.notices[0]
    never = write(tmp_path / "never", [odometry(i, (0.0,) * 4) for i in range(100)])
    fields = {"x_m": "pose.pose.position.x", "yaw_rad": "pose.pose.orientation.yaw"}
    log = measured(tmp_path, never, **{k: ("/odom", f) for k, f in fields.items()})
    assert "nav.yaw_rad" not in log


def test_stamps_of_headers_that_were_never_set_are_no_times(tmp_path):
    messages = [odometry(i) for i in range(100)]
    for _, _, _, message in messages[10:13]:
        message.header.stamp.sec = message.header.stamp.nanosec = 0
    bag = write(tmp_path / "bag", messages)
    log = measured(tmp_path, bag, stamp=True, x_m=("/odom", "pose.pose.position.x"))
    assert len(log["nav.x_m"]) == 97
    assert (
        "3 messages without a time stamp in their header were left out"
        in log.notices[0]
    )


@pytest.mark.parametrize("stamp", [None, "header"])
def test_only_a_clock_whose_stamps_are_used_must_not_be_set_back(tmp_path, stamp):
    """The recorder's clock is set back in one bag, the sender's in the other."""
    messages = [joints(i, NAMES, [5.0 + 0.01 * i, 0.0]) for i in range(200)]
    late = [
        (*sent, at(i % 100), message) for i, (*sent, _, message) in enumerate(messages)
    ]
    recorder = write(tmp_path / "recorder", late)
    messages = [
        (topic, kind, at(i), joints(i % 100, NAMES, [5.0, 0.0])[-1])
        for i, (topic, kind, _, _) in enumerate(messages)
    ]
    sender = write(tmp_path / "sender", messages)
    wrong, right = (sender, recorder) if stamp else (recorder, sender)
    wheel = ("/joint_states", "velocity[front_left_joint]")
    assert len(measured(tmp_path, right, stamp=stamp, speed=wheel)[SPEED]) == 200
    with pytest.raises(LogError, match=r"set back by 1\.98 s after message 100"):
        measured(tmp_path, wrong, stamp=stamp, speed=wheel)


@pytest.mark.parametrize(
    ("storage", "mode"),
    [
        (SQLITE, CompressionMode.FILE),
        (MCAP, CompressionMode.FILE),
        (SQLITE, CompressionMode.MESSAGE),
    ],
)
def test_bags_packed_by_file_or_by_message_are_read(tmp_path, storage, mode):
    messages = [joints(i, NAMES, [i, -i]) for i in range(100)]
    bag = write(tmp_path / "bag", messages, storage, compression=mode)
    log = measured(tmp_path, bag, speed=("/joint_states", "velocity[0]"))
    assert log[SPEED].values.tolist() == list(range(100))
    assert not log.notices


def write_mcap(path, profile, encoding, schema, messages):
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start(profile=profile)
        number = writer.register_schema(*schema) if schema else 0
        channel = writer.register_channel("/odom", encoding, number)
        for i, data in enumerate(messages):
            writer.add_message(channel, at(i), data, at(i))
        writer.finish()
    return path


ROS1 = """Header header
float64 x
================================================================================
MSG: std_msgs/Header
uint32 seq
time stamp
string frame_id
"""


def test_ros_1_in_mcap_is_read(tmp_path):
    messages = [
        struct.pack("<III", i, 1_700_000_000 + i, 0)
        + b"\x03\0\0\0map"
        + struct.pack("<d", i)
        for i in range(50)
    ]
    schema = ("acme/Pose", "ros1msg", ROS1.encode())
    path = write_mcap(tmp_path / "run.mcap", "ros1", "ros1", schema, messages)
    log = measured(tmp_path, path, stamp=True, x_m=("/odom", "x"))
    assert log["nav.x_m"].values.tolist() == list(range(50))
    assert log["nav.x_m"].t_s == pytest.approx(list(range(50)))


@pytest.mark.parametrize(
    "schema", [None, ("Pose", "jsonschema", b'{"type": "object"}')]
)
def test_json_in_mcap_is_read(tmp_path, schema):
    messages = [
        json.dumps(
            {
                "pose": {"x": i if i != 3 else None},
                "joints": [{"name": "a", "v": 2 * i}],
            }
        )
        for i in range(100)
    ]
    data = [message.encode() for message in messages]
    data[7] = b"{"
    path = write_mcap(tmp_path / "run.mcap", "", "json", schema, data)
    log = measured(
        tmp_path, path, x_m=("/odom", "pose.x"), speed=("/odom", "joints[a].v")
    )
    assert log["nav.x_m"].values.tolist() == [i for i in range(100) if i not in (3, 7)]
    assert log[SPEED].values[-1] == 198
    assert "1 messages that cannot be decoded (JSONDecodeError)" in log.notices[0]


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (
            lambda p: write_mcap(
                p / "a.mcap", "", "protobuf", ("P", "protobuf", b""), [b"x"] * 9
            ),
            "topic '/odom': its messages are protobuf; only cdr, ros1 and json can be read",
        ),
        (
            lambda p: write_mcap(p / "a.mcap", "ros2", "cdr", None, [b"\0\1\0\0"] * 9),
            "the definition of its type '' is not in the bag",
        ),
        (
            lambda p: write_mcap(
                p / "a.mcap", "", "json", None, [b"[]", b"1", b""] * 9
            ),
            "topic '/odom': there is no field 'x'",
        ),
    ],
)
def test_containers_are_called_by_their_names(tmp_path, make, complaint):
    with pytest.raises(LogError, match=complaint):
        measured(tmp_path, make(tmp_path), x_m=("/odom", "x"))


@pytest.mark.parametrize("name", ["run.bag", "run.mcap", "run.db3", "run.csv"])
def test_a_bag_of_ros_1_gets_its_remedy_whatever_it_is_called(tmp_path, name):
    (tmp_path / name).write_bytes(b"#ROSBAG V2.0\n" + bytes(4096))
    with pytest.raises(
        LogError, match=f"is a ROS 1 bag; convert it with 'rosbags-convert --src {name}"
    ):
        read_measured([tmp_path / name], "iotbot")


def test_a_mapped_topic_without_messages_is_a_notice(tmp_path):
    bag = write_bag(tmp_path / "bag")
    connection = sqlite3.connect(bag_file(bag))
    connection.execute("DELETE FROM messages WHERE topic_id = 3")
    connection.commit()
    connection.close()
    log = read_measured([bag], "iotbot")
    assert "nav.x_m" not in log
    assert (
        "topic '/poseStamped' contains no messages; there are no data for nav.x_m"
        in log.notices[0]
    )


def whole_bag(folder, storage):
    path = folder / "sound"
    if not path.exists():
        write(path, [joints(i, NAMES, [i, -i]) for i in range(60)], storage)
    return bag_file(path).read_bytes()


@pytest.mark.parametrize("storage", [SQLITE, MCAP])
@given(data=st.data())
@settings(max_examples=30, deadline=None)
def test_any_bytes_are_read_or_refused(tmp_path_factory, storage, data):
    folder = tmp_path_factory.getbasetemp() / storage.name
    folder.mkdir(exist_ok=True)
    sound = bytearray(whole_bag(folder, storage))
    for place in data.draw(st.lists(st.integers(0, len(sound) - 1), max_size=20)):
        sound[place] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(0, len(sound)))
    path = folder / f"a{'.db3' if storage is StoragePlugin.SQLITE3 else '.mcap'}"
    path.write_bytes(bytes(sound[:end] if data.draw(st.booleans()) else sound))
    with contextlib.suppress(LogError):
        measured(folder, path, speed=("/joint_states", "velocity[0]"))


@given(
    st.lists(st.binary(max_size=80), min_size=1, max_size=5),
    st.sampled_from(["cdr", "ros1", "json"]),
)
@settings(max_examples=30, deadline=None)
def test_any_message_is_read_or_counted(tmp_path_factory, messages, encoding):
    folder = tmp_path_factory.getbasetemp()
    schema = ("acme/Pose", "ros1msg", ROS1.encode())
    path = write_mcap(folder / "m.mcap", "", encoding, schema, messages)
    with contextlib.suppress(LogError):
        measured(folder, path, x_m=("/odom", "x"))
