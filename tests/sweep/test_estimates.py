"""Shares and influences against their definitions and against known truths."""

import numpy as np
import pytest
from scipy import stats

from hilserver.sweep.estimates import (
    exact_interval,
    explained,
    influences,
    median_interval,
    paired_p,
)


@pytest.mark.parametrize(
    ("passed", "n"), [(0, 10), (10, 10), (3, 10), (950, 1000), (1, 1)]
)
def test_the_interval_is_that_of_clopper_and_pearson(passed, n):
    low, high = exact_interval(passed, n)
    of_beta = (
        stats.beta.ppf(0.025, passed, n - passed + 1) if passed else 0.0,
        stats.beta.isf(0.025, passed + 1, n - passed) if passed < n else 1.0,
    )
    assert (low, high) == pytest.approx(of_beta, abs=1e-9)


def test_it_covers_the_truth_at_least_as_often_as_it_says():
    rng = np.random.default_rng(1)
    n, intervals = 200, np.array([exact_interval(k, 200) for k in range(201)])
    truth = rng.uniform(0.0, 1.0, 100_000)
    passed = rng.binomial(n, truth)
    low, high = intervals[passed].T
    assert ((low <= truth) & (truth <= high)).mean() >= 0.95


def drawn(n=4000, **more):
    rng = np.random.default_rng(3)
    return {name: rng.uniform(-1.0, 1.0, n) for name in "abc"} | more


def test_what_decides_comes_first():
    x = drawn()
    found = influences(x, x["a"] - 2.0 * x["b"])
    assert [item.names for item in found] == [("b",), ("a",), ("c",)]
    assert (
        found[0].interval[0] < found[0].rank_correlation < found[0].interval[1] < -0.8
    )
    assert found[1].interval[0] > 0.3
    assert found[2].interval[0] < 0.0 < found[2].interval[1]


def test_what_hurts_at_both_ends_comes_first_too():
    x = drawn()
    found = influences(x, 1.0 - 4.0 * x["c"] ** 2 + 0.2 * x["a"])
    assert [item.names for item in found] == [("c",), ("a",), ("b",)]
    assert abs(found[0].rank_correlation) < 0.05
    assert found[0].strength > 0.8


def test_what_is_drawn_together_is_one_group():
    x = drawn()
    x["d"] = x["a"] + 0.1 * x["b"]
    found = influences(x, x["a"] + 0.5 * x["c"])
    assert [item.names for item in found] == [("a", "d"), ("c",), ("b",)]


def test_chance_explains_nothing():
    rng = np.random.default_rng(5)
    found = [explained(rng.normal(size=500), rng.normal(size=500)) for _ in range(200)]
    assert np.mean(found) < 0.01


def test_the_interval_of_a_rank_correlation_holds_its_truth():
    rng, rho, held = np.random.default_rng(7), 0.6, 0
    truth = 6.0 / np.pi * np.arcsin(rho / 2.0)  # of Spearman for a normal pair
    for _ in range(400):
        a, b = rng.multivariate_normal([0, 0], [[1, rho], [rho, 1]], 200).T
        low, high = influences({"a": a}, b)[0].interval
        held += low <= truth <= high
    assert held / 400 == pytest.approx(0.95, abs=0.03)


def test_few_machines_say_nothing():
    assert influences({"a": np.arange(9.0)}, np.arange(9.0)) == []
    constant = influences({"a": np.ones(20), "b": np.arange(20.0)}, np.arange(20.0))
    assert [item.names for item in constant] == [("b",)]


def test_pairs():
    assert paired_p(0, 0) == 1.0
    assert paired_p(10, 0) == pytest.approx(2 * 0.5**10)
    median, low, high = median_interval(np.arange(101.0))
    assert (median, low + high) == (50.0, 100.0)
    assert 35.0 < low < 45.0
