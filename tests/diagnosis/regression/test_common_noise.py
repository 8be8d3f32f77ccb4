"""Two models are compared under weights that take the side of neither."""

import numpy as np
import pytest

from hilserver.diagnosis.regression.fitting import fit
from tests.diagnosis import toy

SHORT, LONG = 200, 2000
"""Samples of four seconds, and of forty."""


def two_models(n):
    """A few samples are far off either model, not the same ones."""
    rng = np.random.default_rng(3)
    columns = {name: np.zeros(n) for name in "ab"}
    columns["a"][: n // 10] = columns["b"][-n // 10 :] = 1.0
    values = 6.0 * columns["a"] + 6.0 * columns["b"] + rng.normal(size=n)
    problem = toy.problem(values, columns)
    _, base = toy.library(problem)
    problem.estimate_noise(problem.residual(base.predicted))
    base = problem.point(base.model, base.poses)
    return problem, *(fit(problem, toy.model(name), base) for name in "ab")


def prefers_the_first(problem, one, other):
    mine, theirs = (problem.point(p.model, p.poses).deviance for p in (one, other))
    return theirs - mine


def test_weights_of_a_model_take_its_side_and_those_between_take_none():
    problem, one, other = two_models(SHORT)
    assert problem.weighs_by_model
    by_one = prefers_the_first(problem.under_noise_of(one), one, other)
    by_other = prefers_the_first(problem.under_noise_of(other), one, other)
    assert by_one > 20.0
    assert by_other < -20.0
    fair = prefers_the_first(problem.between(one, other), one, other)
    assert abs(fair) < 0.2 * (by_one - by_other)
    assert fair == pytest.approx(-prefers_the_first(problem.between(other, one), other, one))


def test_long_segments_have_one_noise_already():
    problem, one, other = two_models(LONG)
    assert problem.between(one, other) is problem
