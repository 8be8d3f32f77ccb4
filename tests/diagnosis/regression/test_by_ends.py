"""Parameters by the ends of free runs: what they hit, and what does not steer them."""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recipe, make

from benchmarks.diagnose_worker import measured
from hilserver.daemon.assembly import assemble
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.by_ends import fit_by_ends
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import HORIZON_S, free_run_errors, windows
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import prepare, stages_of
from hilserver.measured.channels import POSITION, YAW
from tests.diagnosis import toy

CAUSE = "rotation_gain"
RECIPE = Recipe(seed=3, causes={CAUSE: -0.3}, duration_s=120.0)


@pytest.fixture(scope="module")
def prepared():
    log = measured(make(RECIPE)[0])
    slim = log.without([n for n in log.channels if "duty" in n])
    stage = stages_of(slim, assemble(None).robot)["pose"]
    return prepare(stage, 1, Tracker(), frozenset(CAUSES) - {CAUSE})[0]


def fitted(prepared, problem=None):
    c = prepared.library.candidates[0]
    model = prepared.base.model.plus(c, c.beginning)
    return fit(problem or prepared.problem, model, prepared.base)


def showing(problem, values):
    """The same stage and noise with other readings."""
    stage = problem.stage.on(replace(problem.stack, values=values))
    return Problem(stage, problem.noise, problem.weights)


def bent(prepared):
    """The yaw goes astray for some seconds, in a way that no cause does."""
    values, edge = (
        prepared.problem.stack.values.copy(),
        prepared.problem.stack.edges[YAW],
    )
    values[edge] += 0.3 * np.sin(
        2.0 * np.pi * prepared.problem.stack.t_s[edge] / HORIZON_S
    )
    return showing(prepared.problem, values)


def total(problem, point, by):
    """All misses at the end of free runs, by the median ones of a model."""
    runs = windows(problem, HORIZON_S)
    own, first = (free_run_errors(problem, p.predicted, runs) for p in (point, by))
    sizes = (own[key].values / np.median(first[key].values) for key in own)
    return sum(np.sqrt(1.0 + one**2).sum() for one in sizes)


def test_without_a_misfit_both_fits_agree(prepared):
    by_all = fitted(prepared)
    (gain,) = fit_by_ends(prepared.problem, by_all, HORIZON_S).model.theta()
    assert by_all.model.theta() == pytest.approx([-0.3], abs=0.01)
    assert gain == pytest.approx(-0.3, abs=0.02)


def test_free_runs_end_nearer_to_what_was_measured(prepared):
    problem = bent(prepared)
    by_all = fitted(prepared, problem)
    by_ends = fit_by_ends(problem, by_all, HORIZON_S)
    assert total(problem, by_ends, by_all) < total(problem, by_all, by_all)
    assert by_all.deviance < by_ends.deviance


def test_a_run_that_goes_wrong_altogether_does_not_steer(prepared):
    """From one moment on the robot stands a metre away: of all runs one or two cross it."""
    problem = prepared.problem
    values, start = problem.stack.values.copy(), fitted(prepared)
    for name in POSITION:
        edge = problem.stack.edges[name]
        values[edge] += problem.stack.t_s[edge] > 60.0
    (at,), (moved,) = (
        fit_by_ends(
            p, fit(p, start.model, start, iterations=0), HORIZON_S
        ).model.theta()
        for p in (problem, showing(problem, values))
    )
    assert moved == pytest.approx(at, abs=0.01)


def test_where_nothing_runs_freely_nothing_changes():
    rng = np.random.default_rng(0)
    problem = toy.problem(rng.normal(size=400), {"a": rng.normal(size=400)})
    _, base = toy.library(problem)
    point = fit(problem, toy.model("a"), base)
    assert fit_by_ends(problem, point, HORIZON_S) is point
    assert fit_by_ends(problem, base, HORIZON_S) is base
