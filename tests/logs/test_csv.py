"""CSV: every bit comes back, and whatever cannot be read is named with its row and its remedy."""

import json
import math
import struct

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.errors import LogError
from hilserver.logs import RecordedState, open_writer, read_log
from hilserver.logs.csv_writer import meta_path
from tests.logs.samples import NAMES, batch_of, ramp, run_of

BAD_WAITING = 0x80320000


def written(path, *batches, states=()):
    writer = open_writer(path, run_of(), range(len(NAMES)))
    for batch in batches:
        writer.write(batch)
    for state in states:
        writer.add_state(state)
    writer.close()
    return path


def test_what_lies_beside_a_log_is_as_open_as_the_log(tmp_path):
    path = written(tmp_path / "run.csv", batch_of(ramp(3)))
    modes = {beside.stat().st_mode & 0o777 for beside in (path, meta_path(path))}
    assert modes == {path.stat().st_mode & 0o777}
    path.chmod(0o600)
    written(path, batch_of(ramp(3)))
    assert (
        meta_path(path).stat().st_mode & 0o777 == path.stat().st_mode & 0o777 == 0o600
    )


@settings(max_examples=50, deadline=None)
@given(
    st.lists(
        st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=True),
        min_size=4,
        max_size=40,
    )
)
def test_every_number_comes_back_to_the_bit(tmp_path_factory, numbers):
    path = tmp_path_factory.getbasetemp() / "bits.csv"
    rows = [numbers[i : i + 4] for i in range(0, len(numbers) // 4 * 4, 4)]
    log = read_log(written(path, batch_of(rows)))
    for slot, name in enumerate(NAMES):
        assert [struct.pack("d", v) for v in log.columns[name]] == [
            struct.pack("d", row[slot]) for row in rows
        ]


def test_a_recording_says_where_it_comes_from_and_keeps_its_states(tmp_path):
    state = RecordedState(0, 5, np.array([-1, 0, 2**62], dtype=np.int64))
    log = read_log(written(tmp_path / "a.csv", batch_of(ramp(10)), states=[state]))
    assert log.is_ours
    assert log.run["seed"] == 3
    assert log.run["audit"] == [{"name": "governor", "ok": False}]
    assert (log.states[0].tick, log.states[0].words.tolist()) == (5, [-1, 0, 2**62])
    assert log.t_s.tolist() == [tick * 1e-3 for tick in range(10)]
    assert log.ticks(1_000_000).tolist() == list(range(10))


def test_a_bad_status_is_no_sample(tmp_path):
    path = written(
        tmp_path / "a.csv", batch_of(ramp(2), status=[[0, 0, BAD_WAITING, 0]] * 2)
    )
    assert path.read_text().splitlines()[1] == "0.0,0,0.0,-0.0,nan,0.0"
    assert np.isnan(read_log(path).columns["wheel.fl.speed_rpm"]).all()


def test_a_torn_last_line_is_left_out_with_a_notice(tmp_path):
    path = written(tmp_path / "a.csv", batch_of(ramp(10)))
    whole = path.read_bytes()
    for cut in range(1, len(whole.splitlines()[-1]) + 1):
        path.write_bytes(whole[:-cut])
        log = read_log(path)
        assert len(log) == 9
        assert "row 11" in log.notices[0]


@pytest.mark.parametrize("mark", [",", ";"])
def test_a_header_that_stands_there_again_is_skipped_with_a_notice(tmp_path, mark):
    path = tmp_path / "foreign.csv"
    head = f"t_s{mark}wheel.fl.setpoint_rpm\n"
    path.write_text(f"{head}0{mark}1\n{head}1{mark}2\n{head}2{mark}3\n")
    log = read_log(path)
    assert log.columns["wheel.fl.setpoint_rpm"].tolist() == [1, 2, 3]
    assert log.notices == [
        f"{path}: the header is repeated in row 3 and in 1 more; it was skipped there"
    ]


def test_others_may_leave_out_samples_and_the_last_line_end(tmp_path):
    path = tmp_path / "foreign.csv"
    path.write_bytes(
        b"\xef\xbb\xbft_s, wheel.fl.setpoint_rpm,block\r\n0,1.5,1\r\n0.02,,2\r\n1,NaN,2"
    )
    log = read_log(path, {"wheel.fl.setpoint_rpm"})
    assert not log.is_ours
    assert log.t_s.tolist() == [0, 0.02, 1]
    assert log.block.tolist() == [1, 2, 2]
    assert math.isnan(log.columns["wheel.fl.setpoint_rpm"][1])
    assert not log.notices


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (b"", "is empty; the first row must be the header"),
        (b"0.0,1.0\n0.1,2.0\n", "row 1 contains numbers instead of a header; put 't_s"),
        (
            b"time,a\n0,1\n",
            "row 1: there is no column 't_s'; give the time column this name",
        ),
        (
            b"t_s,wheel.fl.setpoint\n0,1\n",
            "row 1, column 2 'wheel.fl.setpoint': there is no such",
        ),
        (b"t_s,wheel.fl.setpoint\n0,1\n", "did you mean 'wheel.fl.setpoint_rpm'?"),
        (b"t_s,a,a\n0,1,2\n", "row 1, column 3 'a': the column appears twice"),
        (
            b"t_s,a\n0,1\n0.1,x\n0.2,1\n",
            "row 3, column 2 'a': 'x' is not a number; write one",
        ),
        (
            b"t_s,a\n0,1\n0.1\n0.2,1\n",
            "row 3 has 1 columns, the header has 2; remove or complete",
        ),
        (
            b"t_s,a\n0,1\n0.2,1\n0.1,1\n",
            "row 4, column 1 't_s': 0.1 is not later than 0.2; sort",
        ),
        (
            b"t_s,a\n0,1\n0.1,1\n0,1\n",
            "0.0 is not later than 0.1; number the runs in a column",
        ),
        (
            b"t_s,a\n0,1\nnan,1\n",
            "row 3, column 1 't_s': the time is missing; every row needs one",
        ),
        (b"t_s,a\n0,1\n,1\n", "row 3, column 1 't_s': the time is missing"),
        (
            b"t_s,segment\n0,0.5\n",
            "row 2, column 2 'segment': 0.5 is not a whole number",
        ),
        (
            b"t_s,a\n0,1\n0.1,\xe4\n",
            "row 3: byte 14 is not UTF-8; save the file as UTF-8",
        ),
        ("t_s,a\n0,1\n".encode("utf-16"), "is not UTF-8; save the file as UTF-8"),
        (b't_s,a\n0,"1\n', "not CSV"),
        (b"t_s,a\n0," + b"1" * 20_000 + b"\n", "not CSV"),
    ],
)
def test_what_cannot_be_read_is_one_sentence(tmp_path, text, complaint):
    path = tmp_path / "log.csv"
    path.write_bytes(text)
    with pytest.raises(LogError) as error:
        read_log(path, ["wheel.fl.setpoint_rpm", "a"])
    assert str(error.value).startswith(str(path))
    assert complaint in str(error.value)
    assert "\n" not in str(error.value)


def test_time_may_fall_between_segments(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("t_s,segment,a\n0,1,1\n1,1,1\n0,2,1\n")
    assert read_log(path).segment.tolist() == [1, 1, 2]


@pytest.mark.parametrize(
    "text", ["", "{}", "[]", '{"schema": "x"}', '{"schema": 1, "states": 2}']
)
def test_a_damaged_file_beside_the_log_is_named(tmp_path, text):
    path = written(tmp_path / "a.csv", batch_of(ramp(3)))
    meta_path(path).write_text(text)
    with pytest.raises(LogError, match=r"a\.csv\.meta\.json: is "):
        read_log(path)


def test_a_damaged_state_is_named(tmp_path):
    state = RecordedState(0, 0, np.zeros(3, dtype=np.int64))
    path = written(tmp_path / "a.csv", batch_of(ramp(3)), states=[state])
    meta = json.loads(meta_path(path).read_text())
    meta["states"][0]["zlib_base64"] = "AAAA"
    meta_path(path).write_text(json.dumps(meta))
    with pytest.raises(LogError, match="is damaged; remove it"):
        read_log(path)


def test_a_log_that_is_not_there_is_said(tmp_path):
    for name in ("a.csv", "a.bag", "a", "a.mcap", "a" * 400):
        with pytest.raises(LogError, match=r"no such file|name too long"):
            read_log(tmp_path / name)
    (tmp_path / "a.bag").write_text("x")
    with pytest.raises(LogError, match=r"supported are \.csv, \.mcap, bags"):
        read_log(tmp_path / "a.bag")
