"""A bag keeps every bit, opens in foreign readers, and holds EduArt's topics beside the signals."""

import contextlib
import errno
import itertools
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.rosbag2 import Reader

from hilserver import commands
from hilserver.errors import LogError
from hilserver.logs import open_writer, read_log, writing
from hilserver.logs.writer import size_of
from hilserver.measured.reading import read_measured
from tests.logs.samples import NAMES, batch_of, ramp, run_of

WHEELS = tuple(f"wheel.{w}.speed_rpm" for w in ("fl", "rl", "fr", "rr"))


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    """A drive of our own, in virtual time."""
    folder = tmp_path_factory.mktemp("recording")
    scenario = folder / "drive.yaml"
    scenario.write_text(
        "steps:\n"
        "  - {at_s: 0.1, write: {wheels.setpoints_rpm: [40, 40, -30, -30]}}\n"
        "  - {at_s: 0.5, write: {wheels.setpoints_rpm: [20, 20, -50, -50]}}\n"
    )
    config = folder / "config.yaml"
    config.write_text("sensors: {nav: {enabled: true}}\n")
    path = folder / "drive.mcap"
    words = ["simulate", str(scenario), "-c", str(config), "-o", str(path)]
    assert commands.main(words) == 0
    return path


def convert(*words):
    assert commands.main(["convert", *map(str, words)]) == 0


def same(first, second):
    assert list(first.columns) == list(second.columns) or set(first.columns) == set(
        second.columns
    )
    np.testing.assert_array_equal(first.t_s.view(np.int64), second.t_s.view(np.int64))
    np.testing.assert_array_equal(first.segment, second.segment)
    for name, values in first.columns.items():
        np.testing.assert_array_equal(values, second.columns[name], err_msg=name)


def test_a_bag_of_mcap_is_packed_as_ros_packs_it(recording, tmp_path):
    for storage in ("mcap", "sqlite3"):
        convert(recording, tmp_path / storage, "--storage", storage)
    assert size_of(tmp_path / "mcap") < 0.3 * size_of(tmp_path / "sqlite3")
    (file,) = (tmp_path / "mcap").glob("*.mcap")
    with file.open("rb") as stream:
        chunks = make_reader(stream).get_summary().chunk_indexes
    assert {chunk.compression for chunk in chunks} == {"zstd"}


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_recording_survives_bag_and_back(recording, tmp_path, storage):
    convert(recording, tmp_path / "bag", "--storage", storage)
    convert(tmp_path / "bag", tmp_path / "again.mcap")
    first, between, last = (
        read_log(path)
        for path in (recording, tmp_path / "bag", tmp_path / "again.mcap")
    )
    for log in (between, last):
        same(first, log)
        for name, codes in first.status.items():
            np.testing.assert_array_equal(codes, log.status[name], err_msg=name)
        assert [(s.segment, s.tick) for s in log.states] == [
            (s.segment, s.tick) for s in first.states
        ]
        assert log.run["configuration"] == first.run["configuration"]


def test_what_is_replayed_from_a_bag_is_the_same_bit_for_bit(
    recording, tmp_path, capsys
):
    convert(recording, tmp_path / "bag")
    convert(tmp_path / "bag", tmp_path / "again.mcap")
    words = [
        "replay",
        str(tmp_path / "again.mcap"),
        "-o",
        str(tmp_path / "x.mcap"),
        "--check",
    ]
    assert commands.main(words) == 0
    assert "equal, bit for bit" in capsys.readouterr().out


def test_a_diagnosis_sees_the_same_numbers_in_recording_and_bag(recording, tmp_path):
    convert(recording, tmp_path / "bag")
    native, bag = (read_measured([path]) for path in (recording, tmp_path / "bag"))
    assert native.spans == bag.spans
    assert set(native.channels) == set(bag.channels)
    for name, channel in native.channels.items():
        for part in ("t_s", "values", "span"):
            ours, theirs = getattr(channel, part), getattr(bag.channels[name], part)
            np.testing.assert_array_equal(ours, theirs, err_msg=name)


@pytest.mark.long
@pytest.mark.timeout(1800)
def test_a_diagnosis_says_the_same_of_log_and_bag(tmp_path):
    """All of it but the name and hash of the log; 18 s of a drive that pulls aside.

    Of EduArt's topics alone, which are rounded to float32, it finds the same things.
    """
    assert (
        commands.main(["scenarios", "make", "pulls_aside", "-o", str(tmp_path / "s")])
        == 0
    )
    lines = (
        (tmp_path / "s" / "logs" / "drive.csv").read_text().splitlines(keepends=True)
    )
    (tmp_path / "log.csv").write_text("".join(lines[:900]))
    convert(tmp_path / "log.csv", tmp_path / "bag")
    config, said = str(tmp_path / "s" / "config.yaml"), []
    for log, more in (("log.csv", []), ("bag", []), ("bag", ["--mapping", "iotbot"])):
        out = tmp_path / f"diagnosis_{len(said)}"
        words = ["diagnose", str(tmp_path / log), *more, "-c", config, "-o", str(out)]
        assert commands.main([*words, "--jobs", "1"]) == 0
        said.append(json.loads((out / "findings.json").read_text()))
        del said[-1]["logs"]
    native, bag, rounded = said
    assert native["findings"]
    assert json.dumps(native) == json.dumps(bag)
    assert [categories(one) for one in rounded["findings"]] == [
        categories(one) for one in native["findings"]
    ]


def categories(finding):
    """What a finding is, without its numbers."""
    return finding["verdict"], finding["causes"], finding["block"]


def test_foreign_numbers_survive_csv_bag_mcap_parquet_csv(tmp_path):
    rng = np.random.default_rng(1)
    t_s = np.cumsum(rng.uniform(1e-3, 0.03, 300))
    lines = ["t_s,segment,block,wheel.fl.speed_rpm,nav.x_m"]
    for i, t in enumerate(t_s.tolist()):
        x = "" if i % 3 else repr(float(rng.normal()))
        lines.append(f"{t!r},{i // 150},{i // 60},{rng.normal() * 1e-7!r},{x}")
    (tmp_path / "0.csv").write_text("\n".join(lines) + "\n")
    chain = ["0.csv", "1_bag", "2.mcap", "3.parquet", "4_bag", "5.csv"]
    for before, after in itertools.pairwise(chain):
        convert(tmp_path / before, tmp_path / after)
    first, last = read_log(tmp_path / "0.csv"), read_log(tmp_path / "5.csv")
    same(first, last)
    np.testing.assert_array_equal(first.block, last.block)
    assert (tmp_path / "0.csv").read_text() == (tmp_path / "5.csv").read_text()


def test_rosbags_reads_every_topic(recording, tmp_path):
    convert(recording, tmp_path / "bag")
    log = read_log(recording)
    with Reader(tmp_path / "bag") as raw:
        counts = {
            connection.topic: connection.msgcount for connection in raw.connections
        }
    with AnyReader([tmp_path / "bag"]) as reader:
        frames = [c for c in reader.connections if c.topic == "/hilserver/frame"]
        for i, (connection, _, data) in enumerate(reader.messages(frames)):
            message = reader.deserialize(data, connection.msgtype)
            assert message.wheel.fl.speed_rpm == log.columns["wheel.fl.speed_rpm"][i]
        speeds = [c for c in reader.connections if c.topic == "/iotbot/rpm/return"]
        rows = [
            reader.deserialize(data, c.msgtype)
            for c, _, data in reader.messages(speeds)
        ]
    assert counts["/hilserver/frame"] == len(log)
    assert (
        counts["/iotbot/rpm"]
        == counts["/iotbot/rpm/return"]
        == math.ceil(len(log) / 20)
    )
    expected = log.columns["wheel.rr.speed_rpm"][::20].astype(np.float32)
    np.testing.assert_array_equal([row.rear_right_rpm for row in rows], expected)


def test_the_decoder_of_mcap_reads_it(recording, tmp_path):
    convert(recording, tmp_path / "bag")
    seen = {}
    with (tmp_path / "bag" / "bag.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        eduart = ["/iotbot/imu", "/iotbot/battery", "/poseStamped"]
        for _, channel, _, decoded in reader.iter_decoded_messages(topics=eduart):
            seen[channel.topic] = decoded
        frames = reader.iter_decoded_messages(topics=["/hilserver/frame"])
        frame = next(iter(frames))[3]
    assert seen["/iotbot/imu"].header.frame_id == "imu_link"
    assert seen["/iotbot/battery"].voltage > 10
    assert seen["/poseStamped"].header.frame_id == "map"
    log = read_log(recording)
    assert frame.battery.voltage_v == log.columns["battery.voltage_v"][0]


def test_eduarts_topics_are_the_signals_rounded_to_float32(recording, tmp_path):
    convert(recording, tmp_path / "bag")
    convert(tmp_path / "bag", tmp_path / "mapped.csv", "--mapping", "iotbot")
    ours, theirs = read_log(recording), read_log(tmp_path / "mapped.csv")
    for name in (*WHEELS, "wheel.fl.setpoint_rpm", "battery.voltage_v"):
        values = theirs.columns[name]
        expected = ours.columns[name][::20].astype(np.float32).astype(float)
        sent = values[np.isfinite(values)]
        np.testing.assert_array_equal(sent, expected, err_msg=name)
    every = {"imu.gyro_z_rad_s": 20, "nav.x_m": 50, "nav.yaw_rad": 50}
    for name, ticks in every.items():
        values = theirs.columns[name]
        sent = values[np.isfinite(values)]
        np.testing.assert_allclose(sent, ours.columns[name][::ticks], atol=1e-15)


def test_driven_by_a_twist_the_target_is_what_the_wheels_are_asked_to_do(tmp_path):
    scenario = tmp_path / "twist.yaml"
    scenario.write_text(
        "steps:\n"
        "  - {at_s: 0.1, write: {wheels.setpoints_rpm: [40, 40, -30, -30]}}\n"
        "  - {at_s: 0.3, write: {control.mode: 1, twist.linear_m_s: 0.3}}\n"
    )
    words = [
        "simulate",
        str(scenario),
        "--duration",
        "0.7",
        "-o",
        str(tmp_path / "drive.mcap"),
    ]
    assert commands.main(words) == 0
    convert(tmp_path / "drive.mcap", tmp_path / "bag")
    convert(tmp_path / "bag", tmp_path / "mapped.csv", "--mapping", "iotbot")
    ours, theirs = read_log(tmp_path / "drive.mcap"), read_log(tmp_path / "mapped.csv")
    for wheel in ("fl", "rl", "fr", "rr"):
        demand = ours.columns[f"wheel.{wheel}.demand_rpm"][::20]
        told = theirs.columns[f"wheel.{wheel}.setpoint_rpm"]
        np.testing.assert_array_equal(told, demand.astype(np.float32))
        assert abs(told[-1]) == pytest.approx(33.7, abs=0.1)


def test_the_recording_of_the_thesis_maps_the_targets(recording, tmp_path):
    convert(recording, tmp_path / "bag")
    convert(tmp_path / "bag", tmp_path / "mapped.csv", "--mapping", "iotbot_5_6")
    log = read_log(tmp_path / "mapped.csv")
    np.testing.assert_array_equal(
        log.columns["wheel.fl.speed_rpm"], log.columns["wheel.fl.setpoint_rpm"]
    )


def test_a_recording_is_no_fault_to_the_mapping_of_its_own_topics(recording, tmp_path):
    """The tag measures 20 times a second and is written as often: no sample is held."""
    convert(recording, tmp_path / "bag")
    log = read_measured([tmp_path / "bag"], "iotbot")
    assert np.allclose(np.diff(log["nav.x_m"].t_s), 0.05)
    with Reader(tmp_path / "bag") as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/poseStamped"] == math.ceil(len(read_log(recording)) / 50)


def test_ticks_that_a_recording_leaves_out_cost_no_messages(recording, tmp_path):
    log = read_log(recording)
    some = slice(None, None, 3)
    columns = {name: values[some] for name, values in log.columns.items()}
    status = {name: words[some] for name, words in log.status.items()}
    thin = replace(
        log,
        t_s=log.t_s[some],
        segment=log.segment[some],
        columns=columns,
        status=status,
    )
    writing.write_log(thin, tmp_path / "bag", "mcap")
    with Reader(tmp_path / "bag") as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/iotbot/rpm/return"] == math.ceil(len(log) / 20)


def test_nothing_is_made_up_for_what_a_log_does_not_hold(tmp_path):
    """Neither a temperature of nobody, nor a pose where the tag was out of sight."""
    rows = "".join(
        f"{0.05 * i},20.0,{0.1 * i if i % 4 == 0 else ''},{0.2 * i if i % 2 == 0 else ''},0.0\n"
        for i in range(12)
    )
    header = "t_s,battery.voltage_v,nav.x_m,nav.y_m,nav.yaw_rad"
    (tmp_path / "0.csv").write_text(f"{header}\n{rows}")
    convert(tmp_path / "0.csv", tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        topics = {c.topic: c for c in reader.connections}
        poses = [
            reader.deserialize(data, c.msgtype).pose.position.x
            for c, _, data in reader.messages([topics["/poseStamped"]])
        ]
    assert "/iotbot/temperature" not in topics
    assert topics["/iotbot/battery"].msgcount == 12
    assert poses == pytest.approx([0.0, 0.4, 0.8])


def test_every_row_of_others_is_a_message(tmp_path):
    rows = "".join(f"{t},20.0\n" for t in (0.0, 0.0203, 0.0391, 0.0612))
    (tmp_path / "0.csv").write_text(f"t_s,battery.voltage_v\n{rows}")
    convert(tmp_path / "0.csv", tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        counts = {c.topic: c.msgcount for c in reader.connections}
    assert counts["/iotbot/battery"] == 4


def test_a_few_signals_give_the_topics_that_they_suffice_for(tmp_path):
    (tmp_path / "0.csv").write_text("t_s,battery.voltage_v\n0.0,20.0\n0.5,19.5\n")
    convert(tmp_path / "0.csv", tmp_path / "bag")
    with Reader(tmp_path / "bag") as reader:
        topics = {c.topic for c in reader.connections}
    assert "/iotbot/battery" in topics
    assert "/iotbot/imu" not in topics


def test_what_no_sensor_measured_is_marked_in_the_imu(tmp_path):
    """A rate alone: neither heading nor acceleration, and in one row nothing of the IMU at all."""
    wheels = [
        name.replace("speed", what) for name in WHEELS for what in ("speed", "setpoint")
    ]
    cells = ",".join(["1.0"] * len(wheels))
    rows = "".join(f"{0.02 * i},{cells},{0.25 if i != 2 else ''}\n" for i in range(5))
    header = ",".join(["t_s", *wheels, "imu.gyro_z_rad_s"])
    (tmp_path / "0.csv").write_text(f"{header}\n{rows}")
    convert(tmp_path / "0.csv", tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        imu = [c for c in reader.connections if c.topic == "/iotbot/imu"]
        sent = [
            reader.deserialize(data, c.msgtype) for c, _, data in reader.messages(imu)
        ]
    parts = ("orientation", "angular_velocity", "linear_acceleration")
    assert [[getattr(m, f"{part}_covariance")[0] for part in parts] for m in sent] == [
        [-1.0, 0.0, -1.0]
    ] * 4
    convert(tmp_path / "bag", tmp_path / "mapped.csv", "--mapping", "iotbot")
    log = read_log(tmp_path / "mapped.csv")
    known = {name for name, values in log.columns.items() if np.isfinite(values).any()}
    assert known == {*wheels, "imu.gyro_z_rad_s"}


@pytest.mark.parametrize(
    ("words", "said", "code"),
    [
        (["none.csv", "x.mcap"], "no such file", 2),
        (["in.csv", "x.xlsx"], "end the name in", 2),
        (["in.csv", "in.csv"], "already exists", 1),
        (["folder", "x.csv"], "contains no bag", 2),
        (["in.csv", "x.csv", "--mapping", "nothing"], "built-in mappings are", 2),
        (["empty.mcap", "x.csv"], "contains no rows; there is nothing to convert", 2),
    ],
)
def test_what_cannot_be_converted_is_a_sentence(
    tmp_path, monkeypatch, capsys, words, said, code
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in.csv").write_text("t_s,battery.voltage_v\n0.0,20.0\n")
    (tmp_path / "folder").mkdir()
    open_writer(Path("empty.mcap"), run_of(), range(len(NAMES))).close()
    assert commands.main(["convert", *words]) == code
    assert said in capsys.readouterr().err


@pytest.mark.parametrize("out", ["x.mcap", "x.csv", "x"])
def test_a_disk_that_fills_up_leaves_no_half(tmp_path, monkeypatch, capsys, out):
    monkeypatch.chdir(tmp_path)
    with contextlib.closing(
        open_writer(Path("in.mcap"), run_of(), range(len(NAMES)))
    ) as writer:
        writer.write(batch_of(ramp(10)))

    def half(log, writer):
        writer.write(batch_of(ramp(len(log) // 2)))
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(writing, "rewrite", half)
    assert commands.main(["convert", "in.mcap", out]) == 1
    assert capsys.readouterr().err.endswith("no space left; free some\n")
    assert [path.name for path in tmp_path.iterdir()] == ["in.mcap"]


def test_a_folder_that_is_not_there_is_no_unknown_format(tmp_path):
    with pytest.raises(LogError, match="no such file or"):
        read_log(tmp_path / "none")


def test_the_flavour_of_a_run_decides_what_its_bag_holds(tmp_path):
    """A base of diff_drive_controller: its odometry is that of the drive, in its own dimensions."""
    (tmp_path / "config.yaml").write_text(
        "plant: {wheel_radius_m: 0.033, wheelbase_m: null, track_m: 0.16, icr_offset_m: 0}\n"
        "ros2: {flavour: diff_drive}\n"
    )
    (tmp_path / "drive.yaml").write_text(
        "steps: [{at_s: 0.1, write: {control.mode: 1, twist.linear_m_s: 0.1}}]\n"
    )
    words = ["-c", "config.yaml", "-o", "drive.mcap", "--duration", "3"]
    with contextlib.chdir(tmp_path):
        assert commands.main(["simulate", "drive.yaml", *words]) == 0
    convert(tmp_path / "drive.mcap", tmp_path / "bag")
    with AnyReader([tmp_path / "bag"]) as reader:
        topics = {c.topic for c in reader.connections}
        assert {"/odom", "/tf", "/joint_states", "/imu"} <= topics
        assert not [topic for topic in topics if "iotbot" in topic]
        odom = [c for c in reader.connections if c.topic == "/odom"]
        *_, (_, _, last) = reader.messages(odom)
        message = reader.deserialize(last, "nav_msgs/msg/Odometry")
    driven = read_log(tmp_path / "drive.mcap").columns
    assert message.pose.pose.position.x == pytest.approx(driven["pose.x_m"][-1], 0.02)
    assert message.twist.twist.linear.x == pytest.approx(0.1, 0.02)
