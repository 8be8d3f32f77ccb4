"""When what is left is gross but no family is significant."""

import numpy as np
import pytest

from hilserver.diagnosis.decide.structure import remaining
from hilserver.diagnosis.decide.unknown import Family
from tests.diagnosis import toy

BLOCKS, ROWS = 40, 50


@pytest.mark.parametrize("blocks", [1, 3, 12])
def test_single_misplaced_samples_are_no_gross_misfit(monkeypatch, blocks):
    """As a slow sensor has them whose time is known to a row only, about a step."""
    monkeypatch.setattr(toy.LinearStage, "follows_setpoints", False)
    rng = np.random.default_rng(3)
    values = rng.normal(size=BLOCKS * ROWS)
    values[7 : blocks * ROWS : ROWS] += 100.0 * np.resize([1.0, -1.0], blocks)
    problem = toy.problem(values, {})
    wave = Family("time", ("t_s",), np.sin(np.arange(len(values)))[:, None])
    point = problem.point(toy.Model(), np.zeros((0, 3)))
    assert point.deviance > 2.0 * len(values)
    assert remaining(problem, point, rng, [wave], 0.0) == []


@pytest.mark.parametrize(("blocks", "found"), [(15, False), (25, True)])
def test_a_drive_that_is_missed_nearly_everywhere_is_no_silence(blocks, found):
    """A controller of an unknown clock left 70 million, and nothing was found.

    Few blocks may be those of a set-point that came and went between two rows.
    """
    rng = np.random.default_rng(3)
    values = rng.normal(size=BLOCKS * ROWS)
    values[: blocks * ROWS] *= 20.0
    problem = toy.problem(values, {})
    wave = Family("time", ("t_s",), np.sin(np.arange(len(values)))[:, None])
    point = problem.point(toy.Model(), np.zeros((0, 3)))
    assert bool(remaining(problem, point, rng, [wave], 0.0)) is found
