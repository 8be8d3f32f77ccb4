"""Curves of both recordings for a plot: thinned, but nothing that differs gets lost."""

import json

import numpy as np
import pytest

from hilserver.comparison import Curves, compare
from tests.comparison.test_comparing import log, pieces

N = 50_000


def drawn(a, b, cuts=()):
    curves = Curves()
    found = compare(iter(pieces(a, cuts)), iter(pieces(b, cuts)), see=curves.add)
    return found, json.loads(curves.as_json(found))


def values_of(series):
    return {value for value in series if value is not None}


@pytest.mark.parametrize("cuts", [(), (1, 700, 30_000)])
def test_one_row_of_fifty_thousand_is_still_seen(cuts):
    x_m = np.zeros(N)
    spiked = x_m.copy()
    spiked[31_415] = 7.0
    found, shown = drawn(log({"pose.x_m": x_m}), log({"pose.x_m": spiked}), cuts)
    (curve,) = shown["signals"]
    assert len(shown["t_s"]) == len(curve["a"]) == len(curve["b"]) < 2100
    assert values_of(curve["a"]) == {0.0}
    assert values_of(curve["b"]) == values_of(curve["difference"]) == {0.0, 7.0}
    at_s = shown["t_s"][curve["b"].index(7.0)]
    assert at_s == pytest.approx(found.partings[0].t_s, rel=0.002)
    assert curve["parts_at_s"] == found.partings[0].t_s
    assert curve["unit"] == "m"


def test_few_rows_are_all_there():
    values = np.arange(100.0)
    _, shown = drawn(log({"pose.x_m": values}), log({"pose.x_m": values + 0.5}))
    (curve,) = shown["signals"]
    assert curve["a"] == values.tolist()
    assert curve["b"] == (values + 0.5).tolist()
    assert shown["t_s"] == pytest.approx(np.arange(100) * 0.01, abs=0.002)


def test_segments_stand_one_behind_the_other():
    segment = np.repeat([0, 1], 100)
    t_s = np.tile(np.arange(100) * 0.01, 2)
    a = log({"pose.x_m": np.zeros(200)}, segment=segment, t_s=t_s)
    b = log({"pose.x_m": np.r_[np.zeros(150), np.ones(50)]}, segment=segment, t_s=t_s)
    _, shown = drawn(a, b)
    assert shown["signals"][0]["parts_at_s"] == pytest.approx(0.99 + 0.5)
    assert shown["t_s"] == sorted(shown["t_s"])


def test_the_axis_is_the_clock_of_the_first_segment():
    t_s = np.arange(100) * 0.01 - 5.0
    a = log({"pose.x_m": np.zeros(100)}, t_s=t_s)
    b = log({"pose.x_m": (np.arange(100) >= 50) * 1.0}, t_s=t_s)
    found, shown = drawn(a, b)
    assert shown["t_s"][0] == -5.0
    assert shown["signals"][0]["parts_at_s"] == found.partings[0].t_s == -4.5


def test_a_value_beside_none_and_equal_recordings():
    gap = np.where(np.arange(300) == 200, np.nan, 1.0)
    one = log({"pose.x_m": np.ones(300)})
    _, shown = drawn(one, log({"pose.x_m": gap}))
    (curve,) = shown["signals"]
    assert None in curve["b"]
    assert None not in curve["a"]
    _, shown = drawn(one, one)
    assert shown["signals"] == shown["t_s"] == []
    assert shown["text"].startswith("Equal: 300 rows")


def test_the_signals_that_part_first_are_drawn():
    rows = np.arange(100)
    names = [f"own.s{i:02}" for i in range(40)]
    zeros = {name: np.zeros(100) for name in names}
    later = {name: (rows > 90 - 2 * i) * 1.0 for i, name in enumerate(names)}
    _, shown = drawn(log(zeros), log(later))
    assert [curve["name"] for curve in shown["signals"]] == names[:15:-1]
