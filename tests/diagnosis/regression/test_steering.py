"""Fits beside a block where the model jumps: a robot that nearly misses the edge of a floor."""

import numpy as np
import pytest

from hilserver.diagnosis.decide.shape_search import _unexplained
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import toy

N = 1000
NEAR_MISS = slice(100, 150)


class JumpingStage(toy.LinearStage):
    """What one block shows is beside the truth, and at some values of the cause far beside it."""

    def predict(self, terms, poses=None, *, keep=False):
        predicted = super().predict(terms, poses, keep=keep)
        predicted[NEAR_MISS] += 80.0 if 0.35 < terms.get("turn", 0.0) < 0.45 else 40.0
        return predicted


def test_a_block_that_jumps_does_not_hold_a_fit_where_it_is():
    rng = np.random.default_rng(5)
    columns = {"turn": toy.smooth(rng, N) * 20.0}
    columns["turn"][NEAR_MISS] = 0.0
    problem = toy.problem(0.5 * columns["turn"] + rng.normal(size=N), columns)
    problem.stage.__class__ = JumpingStage
    model = Model().plus(toy.candidate("turn"), (0.3,))
    point = fit(problem, model, problem.point(Model(), np.zeros((0, 3))))
    assert point.model.theta()[0] == pytest.approx(0.5, abs=0.04)


class WorseEverywhere(toy.LinearStage):
    """What its slope promises is never there: any step leaves every block as it is, or worse."""

    predictions = 0

    def predict(self, terms, poses=None, *, keep=False):
        self.predictions += 1
        size = terms.get("turn", 0.0)
        return super().predict(
            {"turn": size if abs(size) <= 0.1 else -size}, poses, keep=keep
        )


def test_a_step_that_fails_alike_in_all_blocks_is_not_tried_again():
    columns = {"turn": np.ones(N)}
    problem = toy.problem(0.8 * columns["turn"], columns)
    problem.stage.__class__ = WorseEverywhere
    start = problem.point(Model(), np.zeros((0, 3)))
    before = problem.stage.predictions
    fit(problem, Model().plus(toy.candidate("turn"), (0.0,)), start)
    at_start, sensitivity, shares = 1, 1, 3
    assert problem.stage.predictions - before == at_start + sensitivity + shares


@pytest.mark.parametrize(
    ("far_off", "same"), [(3.0, True), (30.0, False), (3000.0, False)]
)
def test_a_few_blocks_that_are_far_off_count_as_three(far_off, same):
    loss = np.array([0.0, 1.0, 1.0, 1.0, 1.0, far_off])
    blank = np.zeros(1)
    left = _unexplained(Point(Model(), blank, blank, blank, blank, loss))
    assert left == pytest.approx(7.0)
    assert (loss.sum() == left) == same
