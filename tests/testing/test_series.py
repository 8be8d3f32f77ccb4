"""Tolerance bands, by hand-made series."""

import numpy as np
import pytest

from hilserver.testing.series import Series, assert_within


def series(values):
    tick = np.arange(len(values))
    return Series("x", "m", tick * 0.1, tick, np.array(values, dtype=float))


def test_within_names_the_first_sample_outside():
    series([1, 2, 3]).assert_within(1, 3)
    assert_within(series([1, 2, 3]), high=3)
    with pytest.raises(
        AssertionError, match=r"x left 0 \.\. 2 m: 3 at 0\.200 s \(tick 2\), 1 of 4"
    ):
        series([1, 2, 3, 2]).assert_within(0, 2)
    with pytest.raises(AssertionError, match="x fell below 2 m: 1 at"):
        series([2, 1]).assert_within(low=2)
    with pytest.raises(AssertionError, match="x rose above 2 m: 3 at"):
        series([2, 3]).assert_within(high=2)
    series([9, 2, 3]).assert_within(1, 3, from_s=0.1)
    series([2, 3, 9]).assert_within(1, 3, to_s=0.15)


def test_what_judges_nothing_fails():
    with pytest.raises(AssertionError, match="give low, high or both"):
        assert_within(series([1, 2]))
    with pytest.raises(AssertionError, match=r"shape \(2,\), the part .* \(3,\)"):
        series([1, 2, 3]).assert_near([1, 2], 1)


def test_nan_is_outside_every_band():
    with pytest.raises(AssertionError, match="left"):
        series([1, np.nan]).assert_within(0, 2)
    with pytest.raises(AssertionError, match="left"):
        series([1, np.nan]).assert_near(1, 1)


def test_near_a_reference():
    series([0, 1, 2]).assert_near(np.array([0, 1, 2.05]), 0.1)
    series([0, 1, 2]).assert_near(lambda t: 10 * t, 0.01)
    with pytest.raises(AssertionError, match=r"the reference \+- 0.1"):
        series([0, 1, 2]).assert_near(lambda t: 9 * t, 0.1)


def test_settle_time_and_overshoot():
    step = series([0, 5, 12, 9, 10, 10.1, 10])
    assert step.settle_time_s(10, 0.5) == pytest.approx(0.4)
    assert step.overshoot(10) == pytest.approx(0.2)
    assert series([0, -5, -12]).overshoot(-10) == pytest.approx(0.2)
    step.assert_settles(10, 0.5, within_s=0.41)
    step.assert_overshoot(10, at_most=0.21)
    with pytest.raises(AssertionError, match=r"only after 0\.400 s"):
        step.assert_settles(10, 0.5, within_s=0.3)
    with pytest.raises(
        AssertionError, match=r"does not settle at 20 \+- 1 m within 1 s: it ends at 10"
    ):
        step.assert_settles(20, 1, within_s=1)
    with pytest.raises(
        AssertionError, match=r"overshoots 10 m by 20\.0%, allowed are 10\.0%"
    ):
        step.assert_overshoot(10, at_most=0.1)
    assert series([10, 10]).settle_time_s(10, 0.1) == 0.0


def test_nothing_captured_is_a_failure_of_its_own():
    with pytest.raises(AssertionError, match="nothing was captured"):
        series([]).assert_within(0, 1)
    with pytest.raises(AssertionError, match="no sample between 5 s"):
        series([1, 2]).assert_within(0, 1, from_s=5)
    with pytest.raises(AssertionError, match="no step"):
        series([1, 2]).overshoot(1)
