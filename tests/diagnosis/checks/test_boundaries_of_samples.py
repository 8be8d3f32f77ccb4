"""Each number that decides which samples were measured when: a case on either side of it."""

import numpy as np
import pytest

from hilserver.diagnosis import thresholds as at
from hilserver.diagnosis.checks import copied, dropouts, repetitions, setpoint_runs
from hilserver.diagnosis.checks.runs import runs_of
from hilserver.measured.data import Channel
from tests.diagnosis.checks.samples import ROBOT, log_of

LESS, MORE = 0.9, 1.1
ROW_S = 0.02


def channel(values, row_s=ROW_S):
    values = np.asarray(values, float)
    return Channel(
        np.arange(len(values)) * row_s, values, np.zeros(len(values), dtype=np.int64)
    )


def log(columns, n=400):
    t = np.arange(n) * ROW_S
    return log_of(
        t, {name: np.broadcast_to(v, n).astype(float) for name, v in columns.items()}
    )


def noise(n, seed=0):
    return np.random.default_rng(seed).normal(size=n)


def late_rows(rows, period_s=0.01, gap=4):
    """Rows that miss now and then some in a row."""
    t = np.arange(4000) * period_s
    keep = np.ones(4000, dtype=bool)
    for k in range(round(rows)):
        keep[100 + 300 * k : 100 + 300 * k + round(gap)] = False
    return Channel(t[keep], t[keep], np.zeros(keep.sum(), dtype=np.int64))


def gaps(number):
    return dropouts.missing(late_rows(number), at.SHORTEST_BURST) > 0.0


def gap_rows(rows):
    return dropouts.missing(late_rows(5, gap=rows), at.SHORTEST_BURST) > 0.0


def gap_period(period_s):
    return dropouts.missing(late_rows(5, period_s=period_s), at.SHORTEST_BURST) > 0.0


def every(rows, n=4000, step=1.0, quantum=1e-4):
    """A channel that changes in every so manieth row, by about a step."""
    values = np.cumsum(step * np.sign(noise(n)) + quantum * np.rint(10.0 * noise(n, 1)))
    return channel(values[np.arange(n) // rows * rows])


def held_rate(samples):
    return repetitions.held(samples, runs_of(samples), np.empty(0)) is not None


def held_hz(rate_hz):
    return held_rate(every(round(1.0 / (rate_hz * ROW_S))))


def held_share(share):
    """Of the stretches the rest lasts one row."""
    rng = np.random.default_rng(5)
    lengths = np.where(rng.random(800) < share, 5, 1)
    values = np.repeat(np.cumsum(noise(800)), lengths)
    return held_rate(channel(values))


def held_changes(number):
    return held_rate(every(5, n=5 * round(number) + 5))


def is_copy(share=1.0, off=0.0):
    """The share of changes that a speed follows at once, and by how much it is off."""
    sent = np.cumsum(np.full(101, 1.0))
    last, now = sent[:-1].copy(), sent[1:].copy() + off
    now[: round((1.0 - share) * 100)] += 0.5
    return copied.is_copy(now, sent[1:], last, sent[:-1], 2.0)


def ramps(rows):
    """Straight pieces between set-points that came once in so many rows."""
    corners = np.cumsum(noise(200))
    values = np.interp(np.arange(199 * rows), np.arange(200) * rows, corners)
    return setpoint_runs.period_rows(channel(values)) is not None


def ramps_after_s(time_s):
    return ramps(round(time_s / ROW_S))


def ramps_on_the_clock(share):
    rng = np.random.default_rng(2)
    rows = np.where(rng.random(300) < share, 10, 7)
    at_rows = np.concatenate([[0], np.cumsum(rows)])
    values = np.interp(np.arange(at_rows[-1]), at_rows, np.cumsum(noise(301)))
    return setpoint_runs.period_rows(channel(values)) is not None


def same_slope(share):
    """Two slopes in turn that differ by a share: one straight line, or corners."""
    slope = 1.0 + share * (np.arange(400) // 10 % 2)
    return len(setpoint_runs.pieces(channel(np.cumsum(slope)))[0]) < 10


def set_points(number):
    return setpoint_runs.sent_rate(every(5, n=5 * round(number) + 10)) is not None


def set_points_too_soon(share):
    rows = np.full(1000, 10)
    rows[:: round(1.0 / share)] = 5
    return (
        setpoint_runs.sent_rate(channel(np.repeat(np.cumsum(noise(1000)), rows)))
        is not None
    )


def sent_together(share):
    both = log({"nav.x_m": 0.0, "nav.y_m": 0.0})
    first = {"nav.x_m": np.arange(0, 400, 4), "nav.y_m": np.arange(0, 400, 4)}
    first["nav.y_m"][: round((1.0 - share) * 100)] += 1
    return repetitions.begins_of(both, "nav.x_m", ["nav.y_m"], first).sum() > 100


def copied_steps(rpm):
    sent = channel(rpm * (np.arange(100) % 2))
    return copied.copy_of(sent, sent, 10.0) is not None


def held_quanta(steps):
    """Stairs of one quantum more or less each."""
    rises = np.where(noise(400) > 0.0, steps, steps + 1) * np.where(
        noise(400, 1) > 0.0, 1, -1
    )
    return held_rate(channel(np.repeat(np.cumsum(rises), 5)))


def held_spread(ratio):
    """Stretches that keep no clock, the longest so many times the shortest."""
    rows = np.rint(np.random.default_rng(9).uniform(10, 10 * ratio, 600)).astype(int)
    rows[:100], rows[100:200] = 10, round(10 * ratio)
    return held_rate(channel(np.repeat(np.cumsum(noise(600)), rows)))


def missing(share):
    t = np.arange(20_000) * 0.01
    values = noise(len(t))
    keep = np.ones(len(t), dtype=bool)
    for begin in range(100, 19_900, round(5 / share)):
        keep[begin : begin + 5] = False
    values[~keep] = np.nan
    return bool(
        dropouts.find_missing(log_of(t, {"nav.x_m": values}, has_stamps=True), ROBOT)[1]
    )


@pytest.mark.parametrize("share", [0.09, 0.18, 0.27])
def test_the_share_of_missing_rows_is_right_however_many_are_missing(share):
    rng = np.random.default_rng(1)
    t = ROW_S * (np.arange(6000) + rng.uniform(-0.05, 0.05, 6000))
    t = t[rng.random(6000) > share]
    rows = Channel(t, t, np.zeros(len(t), dtype=np.int64))
    assert dropouts.missing(rows, 1) == pytest.approx(share, rel=0.1)


def test_a_source_without_a_clock_misses_nothing():
    t = np.cumsum(np.random.default_rng(1).gamma(9.0, ROW_S / 9.0, 6000))
    rows = Channel(t, t, np.zeros(len(t), dtype=np.int64))
    assert dropouts.missing(rows, 1) < at.IRREGULAR


@pytest.mark.parametrize(
    ("decides", "holds", "fails"),
    [
        pytest.param(gaps, at.FEWEST_EVENTS, at.FEWEST_EVENTS - 1, id="FEWEST_EVENTS"),
        pytest.param(gap_rows, at.SHORTEST_BURST, at.SHORTEST_BURST - 1, id="SHORTEST_BURST"),
        pytest.param(
            gap_period, LESS * at.MISSING_SLOWEST_S, MORE * at.MISSING_SLOWEST_S,
            id="MISSING_SLOWEST_S",
        ),
        pytest.param(
            held_hz, MORE * at.HELD_SLOWEST_HZ, LESS * at.HELD_SLOWEST_HZ, id="HELD_SLOWEST_HZ"
        ),
        pytest.param(held_share, 0.9, 0.7, id="HELD_SHARE"),
        pytest.param(
            held_changes, at.FEWEST_CHANGES + 1, at.FEWEST_CHANGES - 2, id="FEWEST_CHANGES"
        ),
        pytest.param(is_copy, 0.91, 0.89, id="NEARLY_ALL"),
        pytest.param(
            lambda off: is_copy(off=off), 0.9 * at.NEGLIGIBLE, 1.1 * at.NEGLIGIBLE,
            id="NEGLIGIBLE of a copy",
        ),
        pytest.param(
            ramps_after_s, 0.9 * at.COMMAND_SLOWEST_S, 1.1 * at.COMMAND_SLOWEST_S,
            id="COMMAND_SLOWEST_S",
        ),
        pytest.param(ramps_on_the_clock, 0.95, 0.8, id="NEARLY_ALL on a clock"),
        pytest.param(same_slope, 0.5 * at.SAME, 1.5 * at.SAME, id="SAME"),
        pytest.param(
            set_points, at.FEWEST_CHANGES + 3, at.FEWEST_CHANGES - 3, id="FEWEST_CHANGES sent"
        ),
        pytest.param(
            set_points_too_soon, 0.8 * at.IRREGULAR, 1.3 * at.IRREGULAR, id="IRREGULAR"
        ),
        pytest.param(sent_together, MORE * at.HALF, LESS * at.HALF, id="HALF"),
        pytest.param(
            copied_steps, MORE * at.COPIED_LEAST_CHANGE_RPM, LESS * at.COPIED_LEAST_CHANGE_RPM,
            id="COPIED_LEAST_CHANGE_RPM",
        ),
        pytest.param(held_quanta, at.HELD_QUANTA, at.HELD_QUANTA - 2, id="HELD_QUANTA"),
        pytest.param(held_spread, 0.9 * at.HELD_SPREAD, 1.2 * at.HELD_SPREAD, id="HELD_SPREAD"),
        pytest.param(
            missing, 1.2 * at.MISSING_IN_BURSTS, 0.8 * at.MISSING_IN_BURSTS, id="MISSING_IN_BURSTS"
        ),
    ],
)  # fmt: skip
def test_samples_are_judged_at_their_number(decides, holds, fails):
    assert decides(holds)
    assert not decides(fails)
