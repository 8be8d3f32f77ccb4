"""Margins against their definition, written as slowly as it reads, and by hand."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hilserver.requirements import Requirement, margin

PERIOD_S = 0.25
"""A power of two: times in ticks are exact."""


def of_sample(requirement, value):
    if math.isnan(value):
        return -math.inf
    if requirement.equals is not None:
        return requirement.tolerance - abs(value - requirement.equals)
    distances = []
    if requirement.below is not None:
        distances.append(requirement.below - value)
    if requirement.above is not None:
        distances.append(value - requirement.above)
    return min(distances)


def slow_margin(requirement, values):
    """There is a start such that for all times from it on while it has to hold."""
    times = [index * PERIOD_S for index in range(len(values))]
    end_s = times[-1] if times else -1.0
    if requirement.within_s is None:
        starts = [t for t in times if t >= requirement.after_s][:1]
    else:
        starts = [t for t in times if requirement.after_s <= t <= requirement.within_s]
    best = -math.inf
    for start in starts:
        if requirement.for_s is not None:
            n = math.floor(requirement.for_s / PERIOD_S)
            until = start + n * PERIOD_S
        elif requirement.always or requirement.within_s is None:
            until = end_s
        else:
            until = start
        if until > end_s:
            continue
        inside = [v for t, v in zip(times, values, strict=True) if start <= t <= until]
        best = max(best, min(of_sample(requirement, value) for value in inside))
    return best


bound = st.floats(-5, 5).map(lambda x: round(x, 2))
times_s = st.one_of(st.none(), st.floats(0, 12).map(lambda x: round(x, 2)))


@st.composite
def requirements(draw):
    kind = draw(st.sampled_from(["below", "above", "band", "equals"]))
    keys = {"name": "r", "signal": "s"}
    if kind == "band":
        keys["above"], keys["below"] = sorted([draw(bound), draw(bound)])
    else:
        keys[kind] = draw(bound)
    if kind == "equals":
        keys["tolerance"] = draw(st.sampled_from([0.0, 0.5]))
    after_s, within_s, for_s = (draw(times_s) for _ in range(3))
    after_s = after_s or 0.0
    if within_s is not None:
        after_s, within_s = sorted([after_s, within_s])
    always = for_s is None and draw(st.booleans())
    return Requirement(
        **keys, after_s=after_s, within_s=within_s, for_s=for_s, always=always
    )


samples = st.lists(st.one_of(st.floats(-6, 6), st.just(math.nan)), max_size=50)


@given(requirements(), samples)
def test_as_the_definition_says(requirement, values):
    found = margin(requirement, np.array(values, dtype=float), PERIOD_S)
    assert found == slow_margin(requirement, values)


@given(requirements(), samples.filter(bool), st.floats(0.01, 3.0))
def test_a_looser_bound_raises_the_margin_by_as_much(requirement, values, by):
    looser = {k: getattr(requirement, k) for k in ("below", "above")}
    looser = {
        k: v + (by if k == "below" else -by) for k, v in looser.items() if v is not None
    }
    if requirement.equals is not None:
        looser = {"tolerance": requirement.tolerance + by}
    before = margin(requirement, np.array(values), PERIOD_S)
    after = margin(requirement.model_copy(update=looser), np.array(values), PERIOD_S)
    assert after == pytest.approx(before + by)


X = np.array([0.0, 1.0, 3.0, 5.0, 4.0, 5.5, 5.2])


def of(**keys):
    return margin(Requirement(name="r", signal="x", **keys), X, 1.0)


def test_examples():
    assert of(below=6.0) == 0.5  # until the end, without a word
    assert of(below=6.0, always=True) == 0.5
    assert of(above=4.9, within_s=3) == pytest.approx(0.1)  # 5.0 at 3 s
    assert of(above=4.9, within_s=2) == pytest.approx(-1.9)
    assert of(above=4.9, within_s=4, for_s=1) == pytest.approx(-0.9)  # 5, 4 or 4, 5.5
    assert of(above=4.9, within_s=6, always=True) == pytest.approx(0.3)  # it may end so
    assert of(above=4.5, after_s=3) == -0.5
    assert of(above=4.5, after_s=5, for_s=1) == pytest.approx(0.7)
    assert of(above=4.5, after_s=5, for_s=2) == -math.inf  # the drive ends before
    assert of(above=4.5, after_s=7) == -math.inf
    assert of(equals=5.0, after_s=5) == pytest.approx(-0.5)


def test_times_are_ticks_but_for_rounding():
    values = np.zeros(1001)
    values[700] = -1.0
    requirement = Requirement(name="r", signal="x", above=-0.5, after_s=0.7)
    assert margin(requirement, values, 0.001) == -0.5
    assert (
        margin(requirement.model_copy(update={"after_s": 0.701}), values, 0.001) == 0.5
    )


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        ({"below": 1.0}, "either signal or python"),
        ({"signal": "s"}, "below, above or both, or equals"),
        (
            {"signal": "s", "below": 1.0, "equals": 1.0},
            "below, above or both, or equals",
        ),
        ({"signal": "s", "below": 1.0, "above": 2.0}, "nothing is above 2 and below 1"),
        ({"signal": "s", "below": 1.0, "tolerance": 1.0}, "tolerance goes with equals"),
        (
            {"signal": "s", "below": 1.0, "always": True, "for_s": 1.0},
            "always or for_s",
        ),
        (
            {"signal": "s", "below": 1.0, "after_s": 3.0, "within_s": 1.0},
            "must be at least 3",
        ),
        ({"signal": "s", "below": 1.0, "signals": ["t"]}, "goes with python"),
        ({"signal": "s", "below": math.nan}, "finite"),
    ],
)
def test_what_means_nothing_is_refused(keys, says):
    with pytest.raises(ValueError, match=says):
        Requirement(name="r", **keys)
