"""The search for shapes: which causes are worth one."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.shape_search import refined
from hilserver.diagnosis.decide.trial import Trial
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.thresholds import GROSS
from tests.diagnosis import toy

N = 4000


def region(edge_m):
    """A region whose true edge is at 0.6 m."""
    name = "region" if round(edge_m, 2) == 0.6 else "beside"
    return replace(
        toy.candidate(name), cause="region", moved=lambda m: region(edge_m + m)
    )


@pytest.mark.parametrize(("left", "best"), [(1.4, "region"), (1.02, "imitation")])
def test_only_a_cause_that_leaves_no_more_than_noise_ends_the_search(left, best):
    """A cause beside the true one leaves some variance; the true one needs its shape."""
    rng = np.random.default_rng(1)
    own, other = (10.0 * toy.smooth(rng, N) / 0.16 for _ in "ab")
    rest = np.sqrt(left - 1.0) * rng.normal(size=N)
    columns = {"region": own + rest, "beside": own + 0.3 * other, "imitation": own}
    problem = toy.problem(columns["region"] + rng.normal(size=N), columns)
    point = problem.point(Model(), np.zeros((0, 3)))
    trials = []
    for c in (toy.candidate("imitation"), region(0.0)):
        trial = fit(problem, Model().plus(c, (0.0,)), point)
        trials.append(Trial(c, trial, point.deviance - trial.deviance, 0.0))
    assert point.is_gross
    assert trials[0].point.deviance / N == pytest.approx(left, abs=0.06)
    assert trials[0].point.deviance < GROSS * N < trials[1].point.deviance
    with ThreadPoolExecutor(1) as pool:
        assert refined(problem, point, trials, pool)[0].candidate.cause == best
