"""Outliers of the position stand out from their neighbours; where all are off, the model is."""

from dataclasses import replace

import numpy as np
import pytest
from hilserver_injector import Recipe, make

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.findings.outcome import outliers
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis.hidden.logs import assembly

POSITION = ("nav.x_m", "nav.y_m")


@pytest.fixture(scope="module")
def drive():
    """A problem and its point on a short drive without an effect."""
    recipe = Recipe(seed=5, duration_s=40.0)
    problem = Problem(stages_of(measured(make(recipe)[0]), assembly().robot)["pose"])
    poses = problem.start_poses({})
    problem.estimate_noise(problem.residual(problem.predict({}, poses)))
    return problem, problem.point(Model(), poses)


def found(drive, off_m, *, neighbours):
    """The finding when every fourth position of 6 s is left out, and misses by so much."""
    problem, point = drive
    predicted, weights = point.predicted.copy(), np.ones(len(problem.stack))
    for name in POSITION:
        edge = problem.stack.edges[name]
        t_s = problem.stack.t_s[edge]
        missed = (t_s > t_s[0] + 10.0) & (t_s < t_s[0] + 16.0)
        left_out = missed & (np.arange(len(t_s)) % 4 == 0)
        moved = missed if neighbours else left_out
        predicted[edge][moved] -= off_m / np.sqrt(2.0)
        weights[edge][left_out] = 0.0
    problem = problem.under(problem.noise, weights)
    return outliers(problem, replace(point, predicted=predicted))


def test_positions_that_stand_out_are_outliers(drive):
    finding = found(drive, 2.0, neighbours=False)
    assert finding.causes == ("nav_outliers",)
    assert finding.parameters["nav_outliers.size"].value == pytest.approx(2.0, rel=0.05)


def test_a_stretch_that_the_model_misses_has_no_outliers(drive):
    """A replayed robot that crosses an edge a little elsewhere misses metres of the way."""
    assert found(drive, 2.0, neighbours=True) is None
