"""Where nothing was measured for long a segment ends; shorter gaps and slow logs stay whole."""

import numpy as np
import pytest

from hilserver.measured.data import Channel, MeasuredLog, Span
from hilserver.measured.pauses import cut_at_pauses
from hilserver.measured.reading import read_measured

SPEED, SETPOINT = "wheel.fl.speed_rpm", "wheel.fl.setpoint_rpm"


def log_of(t_s, setpoints):
    t_s = np.asarray(t_s, float)
    at, sent = np.array(setpoints, float).T
    zeros = [np.zeros(len(t), dtype=np.int64) for t in (t_s, at)]
    channels = {
        SPEED: Channel(t_s, t_s.copy(), zeros[0]),
        SETPOINT: Channel(at, sent, zeros[1]),
    }
    return MeasuredLog((), channels, (Span(0, None, float(t_s[0]), float(t_s[-1])),))


def rows(*edges, period_s=0.02):
    return np.concatenate([np.arange(a, b, period_s) for a, b in edges])


@pytest.mark.parametrize(
    "t_s",
    [rows((0, 30)), rows((0, 10), (12.5, 30)), rows((0, 600), period_s=6.0)],
    ids=str,
)
def test_a_log_without_a_pause_stays_as_it_is(t_s):
    log = log_of(t_s, [(0.0, 5.0)])
    assert cut_at_pauses(log) is log


def test_a_pause_ends_a_segment_and_what_was_sent_holds_on():
    log = cut_at_pauses(
        log_of(rows((0, 10), (30, 40)), [(1.0, 5.0), (20.0, 7.0), (32.0, 9.0)])
    )
    assert [(s.number, s.start_s, s.end_s) for s in log.spans] == [
        (0, 0.0, pytest.approx(9.98)), (1, 30.0, pytest.approx(39.98)),
    ]  # fmt: skip
    for index, first in enumerate((0.0, 30.0)):
        t_s, values = log[SPEED].of(index)
        assert len(t_s) == 500
        assert t_s[0] == values[0] == first
    assert [c.tolist() for c in log[SETPOINT].of(0)] == [[1.0], [5.0]]
    assert [c.tolist() for c in log[SETPOINT].of(1)] == [[30.0, 32.0], [7.0, 9.0]]
    (note,) = log.notices
    assert "pauses once, for 20.02 s after t_s = 9.98" in note


@pytest.mark.parametrize("jump_s", [1e6, 1e9])
def test_a_clock_that_jumps_is_counted_on(tmp_path, jump_s):
    path = tmp_path / "log.csv"
    lines = "".join(f"{0.02 * i + jump_s * (i >= 100)},{i}\n" for i in range(200))
    path.write_text(f"t_s,{SPEED}\n{lines}")
    log = read_measured([path])
    assert [round(s.start_s, 6) for s in log.spans] == [0.0, 4.98]
    assert log[SPEED].of(1)[0][0] == pytest.approx(4.98)
    assert "the clock jumps by 1e+0" in log.notices[-1]


@pytest.mark.parametrize("far", ["1e9", "1e300"])
def test_a_row_with_a_wild_stamp_takes_no_time_of_its_own(tmp_path, far):
    path = tmp_path / "log.csv"
    lines = "".join(f"{0.02 * i},{i}\n" for i in range(200))
    path.write_text(f"t_s,{SPEED}\n{lines}{far},7\n")
    log = read_measured([path])
    assert [s.end_s - s.start_s for s in log.spans] == [pytest.approx(3.98), 0.0]
