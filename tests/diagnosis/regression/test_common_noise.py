"""The noise of short segments takes the side of no model: it is what no column explains."""

import numpy as np
import pytest

from hilserver.diagnosis.decide.selection import select, with_noise_anew
from hilserver.diagnosis.regression.fitting import fit
from tests.diagnosis import toy

SHORT, LONG = 200, 2000
"""Samples of four seconds, and of forty."""


def two_models(n):
    """A few samples are far off either model, not the same ones."""
    rng = np.random.default_rng(3)
    columns = {name: np.zeros(n) for name in "ab"}
    for name, begin in (("a", 0), ("b", 5)):
        for k in range(begin, n, 50):
            columns[name][k : k + 5] = 1.0
    values = 6.0 * columns["a"] + 6.0 * columns["b"] + rng.normal(size=n)
    problem = toy.problem(values, columns)
    library, base = toy.library(problem)
    problem.estimate_noise(problem.residual(base.predicted))
    base = problem.point(base.model, base.poses)
    return problem, library, *(fit(problem, toy.model(name), base) for name in "ab")


def prefers_the_first(problem, one, other):
    mine, theirs = (problem.point(p.model, p.poses).deviance for p in (one, other))
    return theirs - mine


def of_its_own(problem, point):
    problem.estimate_noise(problem.residual(point.predicted))


def test_weights_of_a_model_take_its_side_and_those_of_no_model_take_none():
    problem, library, one, other = two_models(SHORT)
    assert problem.is_short
    of_its_own(problem, one)
    by_one = prefers_the_first(problem, one, other)
    of_its_own(problem, other)
    by_other = prefers_the_first(problem, one, other)
    assert by_one > 20.0
    assert by_other < -20.0
    fair = []
    for point in (one, other):
        for _ in range(
            2
        ):  # the first time the columns are fitted under the other's weights
            with_noise_anew(problem, library, problem.point(point.model, point.poses))
        fair.append(prefers_the_first(problem, one, other))
    assert fair[0] == pytest.approx(fair[1], abs=0.05 * (by_one - by_other))


def test_long_segments_learn_their_noise_from_the_model():
    problem, library, one, other = two_models(LONG)
    sizes = []
    for point in (one, other):
        with_noise_anew(problem, library, point)
        mine = {name: noise.sd for name, noise in problem.noise.items()}
        of_its_own(problem, point)
        assert mine == {name: noise.sd for name, noise in problem.noise.items()}
        sizes.append(mine)
    assert sizes[0] != sizes[1]


def test_what_a_first_fit_misses_is_not_confirmed_by_its_weights():
    """Samples far from the model without a cause weigh less, and those are what shows the cause."""
    rng = np.random.default_rng(5)
    columns = {"a": rng.normal(size=SHORT)}
    values = 3.0 * columns["a"] + rng.normal(size=SHORT)
    problem = toy.problem(values, columns, block_s=0.1)
    library, base = toy.library(problem)
    problem.estimate_noise(problem.residual(base.predicted))
    base = problem.point(base.model, base.poses)
    library.rewhiten(base)
    point = select(problem, library, base, rng).point
    assert point.model.causes == ("a",)
    again = with_noise_anew(problem, library, point)
    at, later = (p.model.theta()[0] for p in (point, again))
    sd = float(np.sqrt(np.sum(columns["a"] ** 2))) ** -1
    assert at == pytest.approx(later, abs=0.1 * sd)
