"""The clock of a controller in the duties, and a replay that keeps step with it."""

import pytest

from benchmarks.diagnose_worker import measured
from hilserver.diagnosis.decide.shape_search import searched
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import _as_configured
from hilserver.diagnosis.replay.control_clock import periods_shown
from hilserver.diagnosis.replay.drive_stage import DriveStage, parts_of_tick
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis.blind.drawing import FIRST, SECOND, Drive

LENGTH_S = 8.0
EXACT_S = 1e-6


def bench(maker, causes, seed=11):
    return measured(Drive(maker, "bench", seed, LENGTH_S).log(causes, seed + 1))


@pytest.mark.parametrize(
    ("maker", "period_s"), [(FIRST, 0.0069), (SECOND, 0.0111234), (SECOND, 0.0047313)]
)
def test_a_search_finds_any_period(maker, period_s):
    """From usual periods alone it used to miss all that are none of them."""
    stage = DriveStage(
        bench(maker, {"control_period": period_s}), RobotParameters(), block_s=1.0
    )
    problem = Problem(stage)
    point = _as_configured(problem)
    assert point.is_gross
    starts = [c for c in stage.candidates() if c.cause == "control_period"]
    candidate, (found,) = searched(problem, point, starts)
    assert found == pytest.approx(period_s, abs=EXACT_S)
    explained = problem.point(point.model.plus(candidate, (found,)), point.poses)
    assert explained.deviance < 0.05 * point.deviance


def test_slow_rows_show_no_clock():
    drive = Drive(SECOND, "drive", 11, 20.0).log({"control_period": 0.0069}, 12)
    assert periods_shown(measured(drive)) == []


@pytest.mark.parametrize(
    ("terms", "parts"),
    [
        ({}, 1),
        ({"control_period": 0.007}, 1),
        ({"control_period": 0.0025}, 2),
        ({"control_period": 0.0069}, 10),
        ({"control_period": 0.00691}, 10),
        ({"control_period": 0.0069, "actuation_delay": 0.9}, 1),
    ],
)
def test_a_tick_has_as_many_parts_as_the_controller_needs(terms, parts):
    assert parts_of_tick(RobotParameters(terms=terms)) == parts
