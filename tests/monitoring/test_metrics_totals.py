"""Totals never fall, whatever the sources do, and lose nothing where a reset is announced."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from hilserver.metrics import MetricReading, counter
from hilserver.monitoring.metrics import LifetimeTotals

increments = st.lists(st.integers(0, 1000), min_size=3, max_size=3)
steps = st.lists(st.tuples(increments, st.booleans()), max_size=40)


@given(steps)
def test_announced_resets_lose_nothing(run: list[tuple[list[int], bool]]) -> None:
    totals = LifetimeTotals()
    shown, counted = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for increment, is_reset in run:
        shown = shown + increment
        counted += increment
        assert (
            totals.advance("k", MetricReading(shown, int(shown.sum()))).counts
            == counted
        ).all()
        if is_reset:
            shown = np.zeros(3, np.int64)
            totals.rebase("k", MetricReading(shown))
    assert (
        totals.advance("k", MetricReading(shown, int(shown.sum()))).sum_ns
        == counted.sum()
    )


@given(st.lists(st.lists(st.integers(0, 5), min_size=2, max_size=2), max_size=40))
def test_totals_never_fall(shown: list[list[int]]) -> None:
    totals = LifetimeTotals()
    before = np.zeros(2, np.int64)
    for values in shown:
        after = totals.advance("k", MetricReading(np.array(values))).counts
        assert (after >= before).all()
        before = after


def test_keys_do_not_mix() -> None:
    totals = LifetimeTotals()
    totals.advance("a", counter(5))
    assert totals.advance("b", counter(2)).counts.tolist() == [2]
    assert totals.advance("a", counter(6)).counts.tolist() == [6]


def test_an_answer_is_not_changed_by_later_readings() -> None:
    totals = LifetimeTotals()
    first = totals.advance("k", counter(1))
    totals.advance("k", counter(9))
    assert first.counts.tolist() == [1]
