"""Plots: scales, ticks, decimation."""

import math

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hilserver.diagnosis.report.svg import (
    Plot,
    Scale,
    decimate,
    label,
    path_data,
    picture,
    span_of,
)

FINITE = st.floats(-1e6, 1e6)


def test_a_scale_takes_its_ends_to_the_ends():
    scale = Scale(-1, 3, 50, 450)
    assert [float(scale(v)) for v in (-1, 1, 3)] == [50, 250, 450]
    log = Scale(0.1, 10, 0, 100, is_log=True)
    assert float(log(1.0)) == pytest.approx(50)


@example(879609.9999999999, 1e-6)  # a width of few units in the last place
@given(FINITE, st.floats(1e-6, 1e6))
def test_ticks_are_few_and_inside(low, width):
    scale = Scale(low, low + width, 0, 100)
    ticks = scale.ticks(6)
    assert 2 <= len(ticks) <= 8
    rounding = 1e-6 * width + 4.0 * math.ulp(abs(low) + width)
    assert all(low - rounding <= t <= low + width + rounding for t in ticks)


def test_ticks_are_round():
    assert Scale(0.3, 6.2, 0, 1).ticks(6) == [1, 2, 3, 4, 5, 6]
    assert Scale(0.4, 25, 0, 1, is_log=True).ticks() == pytest.approx(
        [0.5, 1, 2, 5, 10, 20]
    )


def test_decimation_keeps_the_extremes():
    x = np.arange(10_000.0)
    y = np.sin(x / 50)
    y[7777] = 9.0
    kept_x, kept_y = decimate(x, y, 200)
    assert len(kept_x) <= 200
    assert 9.0 in kept_y
    assert (np.diff(kept_x) > 0).all()


def test_a_line_is_broken_where_a_sample_is_missing():
    assert (
        path_data(np.array([0.0, 1, 2, 3]), np.array([0, np.nan, 2, 3]))
        == "M0.0 0.0M2.0 2.0L3.0 3.0"
    )


def test_the_range_leaves_room_and_is_never_empty():
    low, high = span_of(np.array([1.0, np.nan, 3.0]), None)
    assert low < 1 < 3 < high
    low, high = span_of(np.ones(3))
    assert low < 1 < high
    assert span_of(np.array([np.nan])) == (-1.0, 1.0)


@pytest.mark.parametrize(
    ("value", "text"),
    [
        (0.0, "0"),
        (-0.5, "\N{MINUS SIGN}0.5"),
        (1e-6, "10\N{SUPERSCRIPT MINUS}⁶"),
        (2e6, "2·10⁶"),
    ],
)
def test_labels(value, text):
    assert label(value) == text


def test_a_picture_names_itself_and_its_lines():
    plot = Plot((0, 1), (0, 1), "time [s]", "speed <rpm>")
    plot.line(np.array([0.0, 1]), np.array([0.0, 1]), "measured", "a & b")
    svg = picture([plot], 'the "name"')
    assert 'aria-label="the &quot;name&quot;"' in svg
    assert "<title>a &amp; b</title>" in svg
    assert "speed &lt;rpm&gt;" in svg
