"""Logs that can be read: tables, recordings, bags, torn ones, several of one machine."""

import math
import re
import sqlite3

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.logs.csv_fast import parse_clean
from hilserver.logs.csv_reader import read_table
from hilserver.logs.writing import open_writer
from hilserver.measured.reading import read_measured
from tests.logs.samples import batch_of, run_of
from tests.measured.samples import (
    MCAP,
    SQLITE,
    bag_file,
    write_bag,
    write_chunks,
    write_csv,
)

SPEED = "wheel.fl.speed_rpm"


def test_columns_are_signals_and_empty_fields_no_samples(tmp_path):
    path = tmp_path / "log.csv"
    rows = "".join(f"{0.02 * i},{i},{'' if i % 2 else 2 * i}\n" for i in range(100))
    path.write_text(f"t_s,{SPEED},nav.x_m\n{rows}")
    log = read_measured([path])
    assert log[SPEED].values.tolist() == list(range(100))
    assert log["nav.x_m"].t_s.tolist() == [0.02 * i for i in range(0, 100, 2)]
    assert log.has_stamps
    assert not log.plant
    assert [(s.number, s.block, s.start_s, s.end_s) for s in log.spans] == [
        (0, None, 0, 1.98)
    ]
    assert log.sources[0].file == "log.csv"
    assert len(log.sources[0].sha256) == 64


def test_several_logs_are_pooled_and_their_spans_counted_on(tmp_path):
    first = tmp_path / "a.csv"
    rows = [f"{0.02 * i},{i // 60},{i // 30},{i}" for i in range(120)]
    first.write_text(f"t_s,segment,block,{SPEED}\n" + "\n".join(rows) + "\n")
    second = write_csv(tmp_path / "b.csv", rows=60)
    log = read_measured([first, second])
    assert [(span.number, span.block) for span in log.spans] == [
        (0, 0), (0, 1), (1, 2), (1, 3), (2, None),
    ]  # fmt: skip
    assert np.bincount(log[SPEED].span).tolist() == [30, 30, 30, 30, 60]
    assert log[SPEED].of(4)[1].tolist() == list(range(60))


def test_a_torn_last_line_is_left_out_and_told(tmp_path):
    path = tmp_path / "log.csv"
    rows = "".join(f"{0.02 * i},{i},{i}\n" for i in range(100))
    path.write_text(f"t_s,{SPEED},nav.x_m\n{rows}2.0,1")
    log = read_measured([path])
    assert len(log[SPEED]) == 100
    assert "row 102: the last line is incomplete and was dropped" in log.notices[0]


def write_recording(path, measured):
    names = (
        "wheel.fl.setpoint_rpm", "wheel.fl.speed_rpm", "measured.wheel.fl.speed_rpm", "sim.tick",
    )  # fmt: skip
    writer = open_writer(path, run_of(names), range(4))
    values = [[1.0, 2.0, 3.0, float(i)] for i in range(1500)]
    bad, uncertain = 0x8000_0000, 0x4000_0000
    status = np.zeros((1500, 4), dtype=np.int64)
    if not measured:
        status[:, 2] = bad
    status[:10, 1:3] = uncertain
    writer.write(batch_of(values, status=status))
    writer.close()
    return path


def test_what_the_wheels_were_asked_to_do_stands_for_commands_that_nobody_recorded(
    tmp_path,
):
    path = tmp_path / "log.csv"
    asked = [f"wheel.{w}.demand_rpm" for w in ("fl", "rl", "fr", "rr")]
    rows = "".join(f"{0.02 * i},{i},1,2,-3,{-i}\n" for i in range(100))
    path.write_text(f"t_s,{SPEED},{','.join(asked)}\n{rows}")
    log = read_measured([path])
    assert log["wheel.fl.setpoint_rpm"].values.tolist() == [1.0] * 100
    assert log["wheel.rr.setpoint_rpm"].values[-1] == -99.0
    assert not any(name in log for name in asked), "nobody measured it"

    rows = "".join(f"{0.02 * i},{i},1,2,-3,{-i},0.1,0.2\n" for i in range(100))
    path.write_text(
        f"t_s,{SPEED},{','.join(asked)},twist.linear_m_s,twist.angular_rad_s\n{rows}"
    )
    assert set(read_measured([path]).channels) == {
        SPEED, "twist.linear_m_s", "twist.angular_rad_s",
    }  # fmt: skip


def test_set_points_of_zero_are_not_what_turns_the_wheels(tmp_path):
    path = tmp_path / "log.csv"
    zero = [f"wheel.{w}.setpoint_rpm" for w in ("fl", "rl", "fr", "rr")]
    rows = "".join(f"{0.02 * i},30,0,0,0,0\n" for i in range(100))
    path.write_text(f"t_s,{SPEED},{','.join(zero)}\n{rows}")
    log = read_measured([path])
    assert set(log.channels) == {SPEED}
    assert any("record wheel.fl.demand_rpm" in notice for notice in log.notices)

    at_rest = "".join(f"{0.02 * i},{i % 2},0,0,0,0\n" for i in range(100))
    path.write_text(f"t_s,{SPEED},{','.join(zero)}\n{at_rest}")
    assert set(read_measured([path]).channels) == {SPEED, *zero}

    asked = [f"wheel.{w}.demand_rpm" for w in ("fl", "rl", "fr", "rr")]
    rows = "".join(f"{0.02 * i},30,0,0,0,0,30,30,-30,-30\n" for i in range(100))
    path.write_text(f"t_s,{SPEED},{','.join((*zero, *asked))}\n{rows}")
    assert read_measured([path])["wheel.fl.setpoint_rpm"].values[0] == 30.0


@pytest.mark.parametrize(
    ("measured", "value", "n"), [(True, 3.0, 1490), (False, 2.0, 1500)]
)
def test_in_a_recording_of_ours_the_measured_values_count(tmp_path, measured, value, n):
    log = read_measured([write_recording(tmp_path / "run.mcap", measured)])
    assert set(log.channels) == {"wheel.fl.setpoint_rpm", "wheel.fl.speed_rpm"}
    assert set(log["wheel.fl.speed_rpm"].values) == {value}
    # what comes from outside may be too uncertain
    assert len(log["wheel.fl.speed_rpm"]) == n
    assert len(log["wheel.fl.setpoint_rpm"]) == 1500


def test_a_recording_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path):
    path = tmp_path / "run.mcap"
    writer = open_writer(path, run_of(), range(4))
    for first in range(0, 3000, 100):
        values = np.random.default_rng(first).normal(size=(100, 4))
        writer.write(batch_of(values, first=first))
        writer.flush()
    writer.close()
    path.write_bytes(path.read_bytes()[:-15_000])
    log = read_measured([path])
    assert 1000 < len(log[SPEED]) < 3000
    assert "did not close the file; its last part is missing" in log.notices[0]


MAPPING = """
time: {column: ms, unit: ms}
segment: {column: run}
block: {column: part}
plant: {wheel_radius_m: 0.165, track_m: 0.55}
channels:
  wheel.fl.speed_rpm: {column: left, unit: rad/s}
  wheel.fr.speed_rpm: {column: right, unit: rad/s, sign: -1}
  nav.yaw_rad: {column: heading, unit: deg, sign: -1, scale: 2.0, offset: 0.5}
  wheel.fl.angle_rad: {column: ticks, unit: "1", scale: 0.25}
  nav.x_m: {column: gone, optional: true}
"""


def test_a_mapping_reads_foreign_tables(tmp_path):
    mapping = tmp_path / "map.yaml"
    mapping.write_text(MAPPING)
    path = write_csv(
        tmp_path / "log.csv",
        header="ms,run,part,left,right,heading,ticks,rest",
        row="{i}5,3,7,2,2,90,8,x",
    )
    path.write_text(path.read_text().replace(",x", ",0"))
    log = read_measured([path], mapping)
    assert log["wheel.fl.speed_rpm"].values[0] == pytest.approx(60 / math.pi)
    assert log["wheel.fr.speed_rpm"].values[0] == pytest.approx(-60 / math.pi)
    assert log["nav.yaw_rad"].values[0] == pytest.approx(-math.pi + 0.5)
    assert log["wheel.fl.angle_rad"].values[0] == 2.0
    assert log["nav.yaw_rad"].t_s[1] == pytest.approx(0.015)
    assert "nav.x_m" not in log
    assert {"wheel_radius_m": 0.165, "track_m": 0.55, "wheelbase_m": None}.items() <= (
        log.plant.items()
    )
    assert (log.spans[0].number, log.spans[0].block) == (3, 7)


def test_without_stamps_the_rate_makes_them_and_delays_are_not_judged(tmp_path):
    mapping = tmp_path / "map.yaml"
    mapping.write_text(
        "time: {rate_hz: 50}\nsegment: {column: run}\nchannels: {nav.x_m: {column: x}}\n"
    )
    path = tmp_path / "log.csv"
    path.write_text("run,x\n" + "".join(f"{i // 100},{i}\n" for i in range(200)))
    log = read_measured([path], mapping)
    assert not log.has_stamps
    assert log["nav.x_m"].of(1)[0].tolist() == pytest.approx(
        [0.02 * i for i in range(100)]
    )


@pytest.mark.parametrize("storage", [SQLITE, MCAP])
@pytest.mark.parametrize("as_folder", [True, False])
def test_bags_are_read_without_ros(tmp_path, storage, as_folder):
    folder = write_bag(tmp_path / "bag", storage)
    log = read_measured([folder if as_folder else bag_file(folder)], "iotbot")
    assert log["wheel.fl.setpoint_rpm"].values.tolist() == list(range(100))
    assert log["wheel.rr.speed_rpm"].values.tolist() == list(range(3, 103))
    assert log["nav.yaw_rad"].values == pytest.approx([0.01 * i for i in range(100)])
    assert log["nav.y_m"].values[10] == pytest.approx(-1.0)
    assert log["nav.x_m"].t_s[:2] == pytest.approx([0.005, 0.025])
    assert log["wheel.fl.setpoint_rpm"].t_s[0] == 0.0
    assert "battery.voltage_v" not in log
    assert len(log.spans) == 1
    assert not log.notices


def test_stamps_of_headers_are_taken_when_asked_for(tmp_path):
    mapping = tmp_path / "map.yaml"
    mapping.write_text(
        "time: {stamp: header}\n"
        "channels: {nav.x_m: {topic: /poseStamped, field: pose.position.x, unit: m}}\n"
    )
    log = read_measured([write_bag(tmp_path / "bag")], mapping)
    assert log["nav.x_m"].t_s == pytest.approx([0.02 * i for i in range(100)])


def test_the_thesis_took_speeds_from_the_target_topic(tmp_path):
    log = read_measured([write_bag(tmp_path / "bag")], "iotbot_5_6")
    assert np.array_equal(
        log["wheel.fl.setpoint_rpm"].values, log["wheel.fl.speed_rpm"].values
    )


def test_an_mcap_bag_that_was_cut_off_is_read_as_far_as_it_goes(tmp_path):
    file = write_chunks(tmp_path / "bag.mcap", n=400)
    data = file.read_bytes()
    file.write_bytes(data[: int(len(data) * 0.6)])
    log = read_measured([file], "iotbot")
    assert 60 < len(log["wheel.fl.setpoint_rpm"]) <= 400
    assert "its contents were read" in log.notices[0]


def test_of_a_damaged_sqlite_bag_the_readable_part_is_taken(tmp_path):
    file = bag_file(write_bag(tmp_path / "bag", n=4000))
    data = bytearray(file.read_bytes())
    half = len(data) // 2 // 4096 * 4096
    data[half : half + 8192] = b"\xff" * 8192
    file.write_bytes(bytes(data))
    log = read_measured([file], "iotbot")
    assert 100 < len(log["wheel.fl.setpoint_rpm"]) <= 4000
    assert "everything before that was read" in log.notices[0]


def test_older_sqlite_bags_hold_no_definitions(tmp_path):
    file = bag_file(write_bag(tmp_path / "bag"))
    connection = sqlite3.connect(file)
    connection.execute("DROP TABLE message_definitions")
    connection.commit()
    connection.close()
    log = read_measured([file], "iotbot")
    assert log["wheel.rr.setpoint_rpm"].values[0] == 3.0


def test_parquet_in_our_names_and_mapped(tmp_path):
    pa = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "log.parquet"
    table = {"t_s": [0.02 * i for i in range(100)], SPEED: [None, *range(99)]}
    parquet.write_table(pa.table(table), path)
    log = read_measured([path])
    assert log[SPEED].values.tolist() == list(range(99))
    mapping = tmp_path / "map.yaml"
    mapping.write_text("channels: {nav.x_m: {column: wheel.fl.speed_rpm, unit: mm}}\n")
    assert read_measured([path], mapping)["nav.x_m"].values[-1] == pytest.approx(0.098)


numbers = st.one_of(
    st.just(""),
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
    st.integers(-(10**9), 10**9).map(str),
    st.sampled_from(
        ["nan", "NaN", "1e5", "-0.0", " 1", "1_0", "x", "inf", "0x1", "1.5.2"]
    ),
)


@given(
    st.lists(st.lists(numbers, min_size=3, max_size=3), min_size=1, max_size=6),
    st.booleans(),
)
@settings(max_examples=300, deadline=None)
def test_the_fast_parser_is_the_strict_one_or_says_nothing(
    tmp_path_factory, rows, crlf
):
    end = "\r\n" if crlf else "\n"
    text = end.join(["a,b,c", *(",".join(row) for row in rows)]) + end
    found = parse_clean(text.encode())
    plain = all(
        re.fullmatch(r"-?\d+(\.\d*)?(e[+-]?\d+)?", cell) for row in rows for cell in row
    )
    assert found is not None or not plain, "plain numbers need no second parser"
    if found is None:
        return
    path = tmp_path_factory.mktemp("fast") / "log.csv"
    # quotes: only the strict one
    path.write_bytes(b'"' + text.encode().replace(b"a,", b'a",', 1))
    table = read_table(path, time=None)
    assert found[0] == table.header
    expected = np.stack([table.column(name) for name in table.header], axis=1)
    assert found[1].tobytes() == expected.tobytes() or np.array_equal(
        found[1], expected, equal_nan=True
    )
