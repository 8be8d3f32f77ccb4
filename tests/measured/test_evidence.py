"""A guessed mapping follows what the numbers show, and says why for each channel."""

import contextlib
import re

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import Writer

from hilserver.errors import LogError
from hilserver.measured.proposal import ForeignLog
from hilserver.measured.reading import read_measured
from tests.measured.samples import SQLITE
from tests.measured.test_bag_proposal import STORE, TYPES, header, joints

N = 1500
T = 0.02 * np.arange(N)
AHEAD = 0.4 * np.sin(0.5 * T) ** 2
TURN = 0.8 * np.sin(0.31 * T) * np.cos(0.05 * T)
YAW = np.cumsum(TURN) * 0.02
X, Y = np.cumsum(AHEAD * np.cos(YAW)) * 0.02, np.cumsum(AHEAD * np.sin(YAW)) * 0.02
LEFT, RIGHT = (AHEAD - 0.25 * TURN) / 0.1, (AHEAD + 0.25 * TURN) / 0.1
NOISE = np.random.default_rng(4).normal(size=(8, N))
MARKER = np.where(np.arange(N) % 90 < 4, NOISE[3], np.nan)  # seen now and then
WHEELS = {"t": T, "left_rad_s": LEFT, "right_rad_s": RIGHT}


def proposal(folder, columns, units=()):
    """Return signals with column and reason, as guessed for a table with these columns."""
    rows = [
        ",".join("" if np.isnan(x) else f"{x:.6f}" for x in row)
        for row in zip(*columns.values(), strict=True)
    ]
    lines = [",".join(columns), *units, *rows]
    path = folder / "log.csv"
    path.write_text("\n".join(lines) + "\n")
    with pytest.raises(ForeignLog) as refusal:
        read_measured([path])
    return guessed(refusal.value.proposal)


def guessed(text):
    found = (yaml.safe_load(text) or {}).get("channels", {}) if text else {}
    reasons = dict(re.findall(r"^  (\S+): .*?#\s*(.*)$", text, re.MULTILINE))
    return {
        signal: (
            channel.get("column") or f"{channel['topic']} {channel['field']}",
            reasons[signal],
        )
        for signal, channel in found.items()
    }


def columns_of(found):
    return {signal: column for signal, (column, _) in found.items()}


@pytest.mark.parametrize(
    "others",
    [
        {"Gyro_pitch": 0, "Gyro_roll": 1, "Gyro_yaw": "turn"},
        {"gyro_x": 0, "gyro_y": 1, "gyro_z": "turn"},
        {"gyro_x": 0, "gyro_y": "turn", "gyro_z": 1},  # mounted on its side
        {"imu_roll_rate": 0, "imu_pitch_rate": 1, "imu_yaw_rate": "turn"},
        {"gyro_a": 0, "gyro_b": "turn"},
    ],
)
def test_the_axis_that_turns_with_the_wheels_is_the_turn_rate(tmp_path, others):
    columns = {
        name: TURN + 0.02 * NOISE[2] if what == "turn" else 0.05 * NOISE[what]
        for name, what in others.items()
    }
    (right,) = (name for name, what in others.items() if what == "turn")
    column, why = proposal(tmp_path, WHEELS | columns)["imu.gyro_z_rad_s"]
    assert column == right
    assert re.fullmatch(r"turns with the wheels \(r = (0\.9\d|1\.00)\)", why)


def test_a_pitch_rate_alone_is_no_turn_rate(tmp_path):
    found = proposal(tmp_path, WHEELS | {"Gyro_pitch": 0.05 * NOISE[1]})
    assert "imu.gyro_z_rad_s" not in found


@pytest.mark.parametrize("mirrored", [1.0, -1.0])
def test_the_place_that_moves_with_the_wheels_is_the_pose(tmp_path, mirrored):
    columns = {
        "t": T, "left_rpm": LEFT, "right_rpm": mirrored * RIGHT,
        "x": 0.3 * NOISE[4], "y": 0.3 * NOISE[5],  # of something else
        "robot_x": X, "robot_y": Y, "robot_theta": YAW,
    }  # fmt: skip
    found = proposal(tmp_path, columns)
    assert found["nav.x_m"][0] == "robot_x"
    assert "moves with the wheels" in found["nav.y_m"][1]
    assert found["nav.yaw_rad"][0] == "robot_theta"


def test_markers_are_neither_a_pose_nor_wheels(tmp_path):
    names = (
        "aruco_x", "aruco_y", "aruco_yaw", "marker_left_x", "left_marker_pos",
        "right_marker_pos", "tvec_x", "tvec_y", "marker1_angle", "marker2_angle",
    )  # fmt: skip
    found = proposal(tmp_path, WHEELS | dict.fromkeys(names, MARKER) | {"x": X, "y": Y})
    assert {c for c, _ in found.values()} == {"left_rad_s", "right_rad_s", "x", "y"}


def test_what_was_never_measured_or_has_another_unit_is_not_guessed(tmp_path):
    empty = np.full(N, np.nan)
    columns = WHEELS | {"gyro_z": empty, "x [m/s]": X, "y [m/s]": Y, "x": X, "y": Y}
    found = proposal(tmp_path, columns)
    assert "imu.gyro_z_rad_s" not in found
    assert found["nav.x_m"][0] == "x"
    found = proposal(
        tmp_path, {"t": T, "x": X, "y": Y, "vbat": T}, units=["s,rad/s,rad/s,V"]
    )
    assert columns_of(found) == {"battery.voltage_v": "vbat"}


@pytest.mark.parametrize("known", ["nav.x_m", "wheel.fl.speed_rpm", "t_s", "segment"])
def test_with_one_known_column_the_rest_is_guessed_as_without(tmp_path, known):
    columns = {"time": T, "left_rpm": LEFT, "right_rpm": RIGHT}
    if known == "t_s":
        columns = {"t_s": T, "left_rpm": LEFT, "right_rpm": RIGHT}
    elif known != "segment":
        columns |= {known: X}
    else:
        columns |= {known: 0.0 * T}
    found = columns_of(proposal(tmp_path, columns))
    assert found["wheel.rr.speed_rpm"] == "right_rpm"
    if known.startswith(("nav", "wheel")):
        assert found[known] == known


def bag_of(folder, topics):
    with Writer(folder / "bag", version=9, storage_plugin=SQLITE) as writer:
        for name, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = writer.add_connection(name, kind, typestore=STORE)
            step = max(1, N // len(messages))
            for i, message in enumerate(messages):
                stamp_ns = 10**18 + i * step * 20_000_000
                writer.write(connection, stamp_ns, STORE.serialize_cdr(message, kind))
    with pytest.raises(ForeignLog) as refusal:
        read_measured([folder / "bag"])
    return guessed(refusal.value.proposal)


def motion_of_joints():
    names = ("wheel_left_joint", "wheel_right_joint")
    return [joints(names, velocity=(LEFT[i], RIGHT[i])) for i in range(0, N, 5)]


def imus(axis):
    imu, vector = TYPES["sensor_msgs/msg/Imu"], TYPES["geometry_msgs/msg/Vector3"]
    still = TYPES["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 0.0)
    unknown = np.append(-1.0, np.zeros(8))
    found = []
    for i in range(0, N, 5):
        rates = [0.01 * NOISE[0][i], 0.01 * NOISE[1][i], 0.01 * NOISE[2][i]]
        rates[axis] = TURN[i]
        found.append(
            imu(
                header(),
                still,
                unknown,
                vector(*rates),
                np.zeros(9),
                vector(0.0, 0.0, 9.8),
                unknown,
            )
        )
    return found


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_the_axis_of_an_imu_is_the_one_that_turns_with_the_wheels(tmp_path, axis):
    found = bag_of(tmp_path, {"/joint_states": motion_of_joints(), "/imu": imus(axis)})
    column, why = found["imu.gyro_z_rad_s"]
    assert column == f"/imu angular_velocity.{'xyz'[axis]}"
    assert why.startswith("turns with the wheels")


def test_a_pose_in_the_plane_and_a_bare_pose_are_poses(tmp_path):
    plane = TYPES["geometry_msgs/msg/Pose2D"]
    poses = [plane(x=X[i], y=Y[i], theta=YAW[i]) for i in range(0, N, 5)]
    found = bag_of(tmp_path, {"/joint_states": motion_of_joints(), "/pose2d": poses})
    assert columns_of(found)["nav.yaw_rad"] == "/pose2d theta"
    assert found["nav.x_m"][1].startswith("moves with the wheels")


def pose(x, y, yaw):
    point = TYPES["geometry_msgs/msg/Point"](x, y, 0.0)
    turned = TYPES["geometry_msgs/msg/Quaternion"](
        0.0, 0.0, np.sin(yaw / 2), np.cos(yaw / 2)
    )
    return TYPES["geometry_msgs/msg/Pose"](point, turned)


def odometry(x, y, yaw):
    zero = TYPES["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
    twist = TYPES["geometry_msgs/msg/Twist"](zero, zero)
    return TYPES["nav_msgs/msg/Odometry"](
        header(),
        "base_link",
        TYPES["geometry_msgs/msg/PoseWithCovariance"](pose(x, y, yaw), np.zeros(36)),
        TYPES["geometry_msgs/msg/TwistWithCovariance"](twist, np.zeros(36)),
    )


def test_a_ground_truth_comes_before_odometry_and_what_does_not_move_last(tmp_path):
    rows = range(0, N, 5)
    topics = {
        "/joint_states": motion_of_joints(),
        "/dock_pose": [pose(1.0, 2.0, 0.0) for _ in rows],
        "/odom": [odometry(X[i], Y[i], YAW[i]) for i in rows],
        "/ground_truth/state": [odometry(Y[i], -X[i], YAW[i]) for i in rows],
    }
    found = bag_of(tmp_path, topics)
    assert columns_of(found)["nav.x_m"].startswith("/ground_truth/state ")
    assert "computed from the wheel speeds?" not in found["nav.x_m"][1]
    del topics["/ground_truth/state"]
    (tmp_path / "2").mkdir()
    assert columns_of(bag_of(tmp_path / "2", topics))["nav.x_m"].startswith("/odom ")


@pytest.mark.parametrize(
    ("columns", "says"),
    [
        (
            ["t", "speed", "steering_angle", "x", "y"],
            "'steering_angle' .* steers its wheels",
        ),
        (["t", "rear_left_rpm", "rear_right_rpm", "steerAngle"], "steers its wheels"),
        (
            ["t", "roll", "pitch", "yaw", "thrust"],
            "'thrust' says that this machine flies",
        ),
        (["t", "shoulder_pan", "elbow_joint", "wrist_1"], "is an arm"),
        (
            ["t", *(f"joint_{i}_pos" for i in range(6))],
            "'joint_0_pos' says .* is an arm",
        ),
    ],
)
def test_a_machine_of_another_kind_is_one_sentence(tmp_path, columns, says):
    rows = "".join(
        f"{0.02 * i}" + f",{np.sin(i)}" * (len(columns) - 1) + "\n" for i in range(99)
    )
    (tmp_path / "log.csv").write_text(",".join(columns) + "\n" + rows)
    with pytest.raises(LogError, match=f"{says}.*cannot simulate it") as refusal:
        read_measured([tmp_path / "log.csv"])
    assert not isinstance(refusal.value, ForeignLog)
    assert "\n" not in str(refusal.value)


def test_an_arm_on_wheels_and_a_steering_that_never_moves_are_guessed(tmp_path):
    arm = {f"joint_{i}": NOISE[i] for i in range(6)} | {"steering": 0.0 * T}
    assert "wheel.fl.speed_rpm" in proposal(tmp_path, WHEELS | arm)


cells = st.sampled_from(
    ["", "0", "0.02", "-3", "nan", "x", "rpm", "s", "1e999 s", "0.1 sec", "2026-01-01", "12:00:00",
     "2026-10-25 02:00:00", "Name", "Data-Type", "#", '"', "wheel.fl.speed_rpm", "t_s", "left",
     "9" * 25, "x" * 11_000]
)  # fmt: skip


@given(
    st.one_of(
        st.binary(max_size=200),
        st.tuples(
            st.sampled_from(",;\t |"), st.lists(st.lists(cells, max_size=4), max_size=9)
        ).map(lambda drawn: "\n".join(map(drawn[0].join, drawn[1])).encode()),
    )
)
@settings(max_examples=200, deadline=None)
def test_any_table_without_a_mapping_is_read_guessed_or_refused(tmp_path_factory, data):
    path = tmp_path_factory.getbasetemp() / "any.csv"
    path.write_bytes(data)
    try:
        read_measured([path])
    except ForeignLog as refusal:
        mapping = path.with_suffix(".yaml")
        mapping.write_text(refusal.proposal)
        if refusal.proposal:
            with contextlib.suppress(LogError):
                read_measured([path], mapping)
    except LogError:
        pass
