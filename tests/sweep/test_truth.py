"""Sweeps whose truth is known, at full size, as docs/how-to/sweep.md has them."""

import pytest

from benchmarks import sweep_truth

pytestmark = pytest.mark.long


def ranked(line):
    return [item["names"] for item in line["ranked"]]


def test_a_known_limit_is_found():
    line = sweep_truth.linear()
    assert line["inside"], line
    assert ranked(line) == [["b"], ["a"], ["c"]]
    assert line["wrong_on_the_map"] == 0


def test_a_limit_at_both_ends_is_found():
    line = sweep_truth.not_monotone()
    assert line["inside"], line
    assert ranked(line)[:2] == [["c"], ["a"]]
    assert abs(line["ranked"][0]["rank_correlation"]) < 0.05
    assert line["wrong_on_the_map"] == 0


def test_what_is_drawn_together_is_named_together():
    line = sweep_truth.correlated()
    assert line["inside"], line
    assert sorted(ranked(line)[0]) == ["terms.nav_latency", "terms.rotation_gain"]
    assert len(line["ranked"]) == 1


def test_the_interval_holds_the_truth_as_often_as_it_says():
    assert sweep_truth.coverage()["held"] >= 181
    assert sweep_truth.binomial()["held"] >= 95_000
