"""Periods in ticks, and the sentence that a wrong one gets."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.scheduler.slices import Slice, check_slices, period_in_ticks


@given(base=st.integers(1, 10**9), ticks=st.integers(1, 10**4))
def test_multiples_are_exact(base, ticks):
    assert period_in_ticks("a", base * ticks, base) == ticks


@given(base=st.integers(2, 10**9), ticks=st.integers(1, 10**4), data=st.data())
def test_others_are_refused(base, ticks, data):
    rest = data.draw(st.integers(1, base - 1))
    with pytest.raises(ValueError, match="not a multiple"):
        period_in_ticks("a", base * ticks + rest, base)


def test_the_message_names_the_nearest_two():
    with pytest.raises(
        ValueError, match=r"'sensors': 2\.5 ms .* nearest are 2 ms and 3 ms"
    ):
        period_in_ticks("sensors", 2_500_000, 1_000_000)
    with pytest.raises(ValueError, match=r"0\.25 ms is shorter .* 1 ms and 2 ms"):
        period_in_ticks("sensors", 250_000, 1_000_000)


def test_slices_are_sorted_by_kind_and_checked():
    a, b, c = Slice("a", 1, True), Slice("b", 5, False), Slice("c", 2, True)
    assert check_slices([a, b, c]) == ([a, c], [b])
    with pytest.raises(ValueError, match="given twice: a"):
        check_slices([a, a])
    with pytest.raises(ValueError, match="at least one compiled slice"):
        check_slices([b])
    with pytest.raises(ValueError, match="at least one tick"):
        Slice("z", 0, True)
