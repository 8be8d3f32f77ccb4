"""What a cause may leave by its own form: no other cause is named for that."""

import numpy as np
import pytest

from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.decide.trial import own_error
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import toy

N = 2000
FRICTION = "coulomb_friction"
SHARE = traits_of(FRICTION).abrupt


class Sticking(toy.LinearStage):
    """Wheels that stick where their friction is above an edge, and do something else then."""

    edge = np.inf

    def predict(self, terms, poses=None, *, keep=False):
        shown = super().predict(terms, poses, keep=keep)
        return shown + self.columns["stuck"] * (terms.get(FRICTION, 0.0) > self.edge)


def fitted(edge):
    rng = np.random.default_rng(5)
    column, stuck = (toy.smooth(rng, N) for _ in range(2))
    columns = {FRICTION: 5.0 * column, "stuck": 10.0 * stuck}
    problem = toy.problem(20.0 * columns[FRICTION] + rng.normal(size=N), columns)
    base = problem.point(Model(), np.zeros((0, 3)))
    point = fit(problem, toy.model(FRICTION), base)
    problem.stage.__class__, problem.stage.edge = Sticking, edge
    return problem, point, base.deviance


def test_it_is_the_square_of_twice_a_share_of_what_the_cause_explains():
    problem, point, before = fitted(np.inf)
    explained = before - point.deviance
    assert own_error(problem, point, before) == pytest.approx(
        4 * SHARE**2 * explained, rel=0.05
    )


def test_where_a_small_share_decides_whether_wheels_stick_it_is_what_that_makes():
    problem, point, before = fitted(20.0 * (1.0 + 0.05 * SHARE))
    stuck = float((problem.stage.columns["stuck"] ** 2).sum())
    assert stuck > 10.0 * SHARE**2 * (before - point.deviance)
    assert own_error(problem, point, before) == pytest.approx(4 * stuck, rel=0.5)


def test_a_cause_that_acts_smoothly_leaves_nothing():
    problem, _, before = fitted(np.inf)
    point = problem.point(toy.model("stuck"), np.zeros((0, 3)))
    assert own_error(problem, point, before) == 0.0
