"""Wheel speeds that a driver made of few counts."""

import numpy as np
import pytest

from hilserver.diagnosis.replay.counts import is_counted
from hilserver.diagnosis.replay.wheel_speeds import WheelSpeeds
from hilserver.measured.channels import SPEEDS
from hilserver.measured.clock import cut
from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.plant.units import RPM_PER_RAD_S

PERIOD_S, ROWS = 0.02, 1500
COUNT_RAD = 2.0 * np.pi / 360.0


def angle_at(t_s):
    """A wheel that goes forward, backward and stands."""
    until_s = np.minimum(t_s, 5.0 * np.pi)
    return 8.0 * np.sin(0.5 * until_s) + 0.8 * np.sin(1.5 * until_s)


def counted(jitter_s=0.0):
    """Stamps, speeds from counts and true ones, of the time since the sample before."""
    rng = np.random.default_rng(4)
    t_s = PERIOD_S * np.arange(ROWS)
    counts = np.floor(angle_at(t_s) / COUNT_RAD)
    stamps = t_s + jitter_s * rng.uniform(-1.0, 1.0, ROWS)
    shown = (
        COUNT_RAD * np.diff(counts, prepend=0.0) / np.diff(stamps, prepend=-PERIOD_S)
    )
    true = np.diff(angle_at(t_s), prepend=0.0) / PERIOD_S
    return stamps, shown * RPM_PER_RAD_S, true * RPM_PER_RAD_S


def replayed(t_s, rpm):
    """What a replay without set-points takes for the speed of a side, at these times."""
    channel = Channel(t_s, rpm, np.zeros(len(t_s), dtype=np.int64))
    spans = (Span(0, None, float(t_s[0]), float(t_s[-1])),)
    channels = dict.fromkeys(SPEEDS, channel)
    log = MeasuredLog((LogSource("log.csv", "0" * 64),), channels, spans)
    segments = cut(log, 0.002, None)
    left, _ = WheelSpeeds(log, segments, None).sides()
    return np.interp(t_s, segments.times(0), 0.5 * left)


@pytest.mark.parametrize("jitter_s", [0.0, 0.008])
def test_what_one_count_misses_the_next_one_has(jitter_s):
    t_s, rpm, true = counted(jitter_s)
    rough, smooth = (np.std((v - true)[1:]) for v in (rpm, replayed(t_s, rpm)))
    assert rough > 2.0
    assert smooth < 0.25 * rough


def test_the_way_is_that_of_the_counts():
    t_s, rpm, _ = counted()
    ways = [np.cumsum(v) * PERIOD_S / RPM_PER_RAD_S for v in (rpm, replayed(t_s, rpm))]
    assert np.ptp(ways[1] - ways[0]) < 5.0 * COUNT_RAD


@pytest.mark.parametrize(
    "other", ["rounded", "noisy and rounded", "noisy", "few speeds", "at rest", "fine"]
)
def test_other_speeds_are_taken_as_they_are(other):
    t_s, _, true = counted()
    noise = np.random.default_rng(5).normal(size=ROWS)
    rpm = {
        "rounded": 8.0 * np.rint(true / 8.0),
        "noisy and rounded": 8.0 * np.rint((true + 3.0 * noise) / 8.0),
        "noisy": true + noise,
        "few speeds": 30.0 * np.sign(true),
        "at rest": 0.0 * true,
        "fine": 0.01 * np.rint(true / 0.01),
    }[other]
    assert not is_counted(t_s, rpm)
    seen = np.isin(t_s, PERIOD_S * np.arange(5, ROWS - 5))
    np.testing.assert_allclose(replayed(t_s, rpm)[seen], rpm[seen], atol=1e-6)
