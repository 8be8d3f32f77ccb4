"""When what is left is gross but no family is significant."""

import numpy as np
import pytest

from hilserver.diagnosis.decide.structure import remaining
from hilserver.diagnosis.decide.unknown import Family
from tests.diagnosis import toy

BLOCKS, ROWS = 12, 50


def gross(monkeypatch, missed_blocks):
    """A pose, so to speak, that misses by far at a single sample of some blocks."""
    monkeypatch.setattr(toy.LinearStage, "follows_setpoints", False)
    rng = np.random.default_rng(3)
    values = rng.normal(size=BLOCKS * ROWS)
    values[7 : missed_blocks * ROWS : ROWS] += 100.0 * np.resize([1.0, -1.0], missed_blocks)
    problem = toy.problem(values, {})
    wave = Family("time", ("t_s",), np.sin(np.arange(len(values)))[:, None])
    point = problem.point(toy.Model(), np.zeros((0, 3)))
    return remaining(problem, point, rng, [wave], 0.0)


@pytest.mark.parametrize("missed_blocks", [1, 3])
def test_what_is_missed_in_few_blocks_is_an_event(monkeypatch, missed_blocks):
    assert gross(monkeypatch, missed_blocks) == []


def test_what_is_missed_in_many_blocks_is_never_left_without_a_word(monkeypatch):
    (found,) = gross(monkeypatch, 5)
    assert found.family.name == "time"
