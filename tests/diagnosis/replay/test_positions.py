"""Positions of which both coordinates are known."""

import numpy as np
import pytest

from hilserver.diagnosis.replay.positions import paired
from hilserver.measured.data import Channel, MeasuredLog, Span

N = 200


def log(x_rows, y_rows, spans=2):
    """A robot on a line, y = 2 x, whose spans both begin at zero."""
    t = np.tile(0.05 * np.arange(N // spans), spans)
    span = np.repeat(np.arange(spans), N // spans)
    channels = {
        name: Channel(t[rows], slope * t[rows] + 10.0 * span[rows], span[rows])
        for name, slope, rows in (("nav.x_m", 1.0, x_rows), ("nav.y_m", 2.0, y_rows))
    }
    ends = tuple(Span(k, None, 0.0, float(t[-1])) for k in range(spans))
    return MeasuredLog((), channels, ends)


def test_of_common_rows_those_with_both_coordinates_are_left():
    every = np.arange(N)
    both = paired(log(every[every % 10 != 3], every[every % 10 != 7]))
    x, y = both["nav.x_m"], both["nav.y_m"]
    assert len(x) == len(y) == 0.8 * N
    assert np.array_equal(x.t_s, y.t_s)
    assert y.values - 10.0 * y.span == pytest.approx(2.0 * y.t_s)


def test_coordinates_in_rows_of_their_own_are_paired_between_samples_of_one_span():
    """A topic for each coordinate: nothing would be left, and nothing found."""
    even, odd = np.arange(0, N, 2), np.arange(1, N, 2)
    both = paired(log(even, odd))
    x, y = both["nav.x_m"], both["nav.y_m"]
    assert np.array_equal(x.t_s, y.t_s)
    assert np.array_equal(x.span, y.span)
    assert len(x) == N // 2 - 2, "before the first y of its span there is none"
    assert y.values - 10.0 * y.span == pytest.approx(2.0 * y.t_s)


def test_no_coordinate_is_made_up_where_the_other_was_away():
    even, odd = np.arange(0, N, 2), np.arange(1, N, 2)
    away = (odd > 60) & (odd < 140)
    both = paired(log(even, odd[~away], spans=1))
    assert set(both["nav.x_m"].t_s) == set(
        0.05 * even[(even > 0) & ((even < 60) | (even > 140))]
    )


@pytest.mark.parametrize("missing", ["nav.x_m", "nav.y_m"])
def test_without_one_coordinate_there_is_no_position(missing):
    every, none = np.arange(N), np.zeros(0, dtype=int)
    both = paired(log(*((none, every) if missing == "nav.x_m" else (every, none))))
    assert len(both["nav.x_m"]) == len(both["nav.y_m"]) == 0
