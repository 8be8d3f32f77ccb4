"""Which samples answer commands that a log does not hold."""

import numpy as np
import pytest

from hilserver.diagnosis.replay.missing_rows import without_unknown_commands
from hilserver.diagnosis.thresholds import LOST_SEEN_S
from hilserver.measured.channels import SETPOINTS, SPEEDS
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span

ROW_S, ROWS = 0.02, 500


def log_without(rows, command):
    """A log without some rows; speeds come in rows of their own."""
    t_s = ROW_S * np.arange(ROWS)
    there = ~np.isin(np.arange(ROWS), rows)
    span = np.zeros(ROWS, dtype=np.int64)
    sent = Channel(t_s[there], command[there], span[there])
    channels = dict.fromkeys(SETPOINTS, sent)
    channels |= {name: Channel(t_s, command, span) for name in SPEEDS}
    spans = (Span(0, None, 0.0, float(t_s[-1])),)
    return MeasuredLog((LogSource("log.csv", "0" * 64),), channels, spans)


def left_out(log):
    """Times of the speeds that are not judged."""
    known = without_unknown_commands(log, SETPOINTS, SPEEDS)
    for name in SETPOINTS:
        assert known[name] is log[name]
    (gone,) = {tuple(np.setdiff1d(log[name].t_s, known[name].t_s)) for name in SPEEDS}
    return np.array(gone)


RAMP = np.linspace(0.0, 40.0, ROWS)


def test_what_answers_commands_of_a_missing_row_is_left_out():
    gone = left_out(log_without([100, 101, 300], RAMP))
    for first, last in ((100, 101), (300, 300)):
        begin_s, end_s = ROW_S * (first - 1), ROW_S * (last + 1) + LOST_SEEN_S
        mine = gone[(gone > begin_s - 0.5) & (gone < end_s + 0.5)]
        assert mine[0] == pytest.approx(begin_s, abs=1.01 * ROW_S)
        assert mine[-1] == pytest.approx(end_s, abs=1.01 * ROW_S)
    assert len(gone) < 25


@pytest.mark.parametrize(
    ("rows", "command"),
    [
        ([], RAMP),
        ([100, 101, 300], np.full(ROWS, 10.0)),  # the same before and after
        (range(1, ROWS, 7), RAMP),  # nothing would be left
        (np.flatnonzero(np.arange(ROWS) % 9 < 3), RAMP),  # no clock
        (range(1, ROWS), RAMP),
    ],
)
def test_where_nothing_or_nearly_everything_is_unknown_all_is_judged(rows, command):
    assert len(left_out(log_without(list(rows), command))) == 0
