"""The step that readings come in, whatever file they went through."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.measured.resolution import step_of


def smooth(n=4000, size=50.0):
    rng = np.random.default_rng(3)
    return size * np.sin(np.arange(n) / 300.0) + 0.1 * rng.normal(size=n)


@settings(max_examples=40, deadline=None)
@given(
    step=st.floats(0.002, 1.0),
    origin=st.floats(-100.0, 100.0),
    decimals=st.sampled_from([None, 5, 6]),
)
def test_a_step_is_found_whatever_the_readings_count_from(step, origin, decimals):
    values = origin + step * np.round(smooth() / step)
    if decimals is not None:
        values = np.round(values, decimals)
    found, one = step_of(values)
    if decimals is None and step > 0.05:
        assert found == pytest.approx(step, rel=1e-3)
    if found > 0.0:
        assert (
            np.abs((values - one) / found - np.rint((values - one) / found)).max()
            < 0.03
        )


def test_what_is_not_rounded_has_no_step():
    assert step_of(smooth()) == (0.0, 0.0)
    assert step_of(np.round(smooth(), 6)) == (0.0, 0.0)
    assert step_of(np.zeros(500)) == (0.0, 0.0)
    assert step_of(np.arange(5.0)) == (0.0, 0.0)


def test_few_speeds_that_a_wheel_rests_at_are_no_step():
    rng = np.random.default_rng(4)
    assert step_of(rng.choice([0.0, 11.3, 17.9, 44.123], size=500)) == (0.0, 0.0)
