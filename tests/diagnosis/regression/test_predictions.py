"""A search asks for the same predictions again and again: each is replayed once."""

import numpy as np
import pytest

from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import PREDICTIONS_KEPT
from tests.diagnosis import toy

NO_POSES = np.zeros((0, 3))
COLUMNS = {"a": np.sin(np.arange(500.0)), "b": np.cos(0.3 * np.arange(500.0))}


@pytest.fixture
def replayed(monkeypatch):
    """The terms of every replay of a problem, and the problem."""
    made, terms = toy.problem(2.0 * COLUMNS["a"], COLUMNS), []
    replay = made.stage.predict

    def predict(asked, poses, *, keep=False):
        terms.append(dict(asked))
        return replay(asked, poses, keep=keep)

    monkeypatch.setattr(made.stage, "predict", predict)
    return made, terms


def test_what_was_replayed_lately_is_not_replayed_again(replayed):
    made, terms = replayed
    first = made.predict({"a": 1.0}, NO_POSES)
    expected = first.copy()
    first += 1.0  # a caller's own
    assert np.array_equal(made.predict({"a": 1.0}, NO_POSES), expected)
    assert terms == [{"a": 1.0}]
    made.predict({"a": 2.0}, NO_POSES)
    made.predict({"a": 1.0}, np.ones((1, 3)))
    assert len(terms) == 3


def test_only_the_last_predictions_are_kept_and_none_once_a_search_is_over(replayed):
    made, terms = replayed
    for size in range(PREDICTIONS_KEPT + 1):
        made.predict({"a": float(size)}, NO_POSES)
    made.predict({"a": 0.0}, NO_POSES)
    assert len(terms) == PREDICTIONS_KEPT + 2
    made.forget()
    made.predict({"a": 0.0}, NO_POSES)
    assert len(terms) == PREDICTIONS_KEPT + 3


def test_sensitivities_are_whitened_once_for_a_point_and_a_noise(replayed):
    made, terms = replayed
    point = made.point(toy.model("a"), NO_POSES)
    first = made.accepted(point)
    assert made.accepted(point) is first
    made.noise = {
        name: toy.NoiseModel(2.0 * m.white_sd) for name, m in made.noise.items()
    }
    terms.clear()
    assert made.accepted(point) == pytest.approx(0.5 * first)
    assert not terms  # nor are they replayed again


def test_after_its_last_step_a_fit_asks_for_no_sensitivities(replayed, monkeypatch):
    made, terms = replayed
    linear = made.stage.predict

    def bent(asked, poses, *, keep=False):
        return linear({name: v + v**3 for name, v in asked.items()}, poses, keep=keep)

    monkeypatch.setattr(made.stage, "predict", bent)
    model = toy.model("a")
    start = made.point(model, NO_POSES)
    made.own_columns(start)
    terms.clear()
    found = fit(made, model, start, iterations=1)
    assert found.model.theta() == pytest.approx([1.0], abs=0.05)
    # the whole step, which leads too far, and half of it: not as expected
    assert len(terms) == 2
