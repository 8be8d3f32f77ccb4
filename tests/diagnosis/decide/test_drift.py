"""What changes along a log is named, also where its mean is zero or another cause looks alike."""

from types import SimpleNamespace

import numpy as np
import pytest

from hilserver.diagnosis.decide.drift import course, drifting, parts, with_drift
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.replay.model import Model
from tests.diagnosis import toy

N = 3000
TIME = np.linspace(-1.0, 1.0, N)
SLOW, STEP = TIME, np.sign(TIME)


def columns_of(rng, *names):
    return {name: 20.0 * toy.smooth(rng, N) for name in names}


def judged(problem, *accepted):
    library, base = toy.library(problem)
    point = fit(problem, toy.model(*accepted), base) if accepted else base
    return with_drift(library, point, np.random.default_rng(0))


def test_drift_is_seen_and_a_constant_is_none():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        columns, noise = columns_of(rng, "a"), rng.normal(size=N)
        for slope, wanted in ((0.3, {"a"}), (0.0, set())):
            problem = toy.problem((0.5 + slope * TIME) * columns["a"] + noise, columns)
            base = problem.point(Model(), np.zeros((0, 3)))
            point = fit(problem, toy.model("a"), base)
            assert set(drifting(problem, point, np.random.default_rng(0))) == wanted


@pytest.mark.parametrize("change", [SLOW, STEP], ids=["slow", "step"])
def test_drift_about_the_configured_value_is_found_without_a_mean_effect(change):
    for seed in range(5):
        rng = np.random.default_rng(seed)
        columns = columns_of(rng, *"abcdef")
        problem = toy.problem(0.4 * change * columns["c"] + rng.normal(size=N), columns)
        found = judged(problem)
        assert found.point.model.causes == ("c",)
        assert set(found.p) == {"c"}
        assert found.point.model.terms["c"] == pytest.approx(0.0, abs=0.1)


def test_what_comes_up_in_the_middle_is_found_where_few_moments_show_it():
    """Turns on the spot are a fourth of a drive, and those of its first half show nothing."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        columns = columns_of(rng, *"abcdef")
        columns["c"] = columns["c"] * (np.sin(40.0 * np.pi * TIME) > 0.7)
        problem = toy.problem((STEP > 0) * columns["c"] + rng.normal(size=N), columns)
        found = judged(problem)
        assert found.point.model.causes == ("c",)
        assert set(found.p) == {"c"}


def test_noise_alone_drifts_nowhere():
    for seed in range(20):
        rng = np.random.default_rng(50 + seed)
        problem = toy.problem(rng.normal(size=N), columns_of(rng, *"abcdef"))
        found = judged(problem)
        assert found.p == {}
        assert found.point.model.causes == ()


def test_a_cause_that_stands_in_for_one_that_drifts_gives_way_to_it():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        columns = columns_of(rng, "true", "other")
        # part of the way only
        columns["late"] = np.where(TIME > 0.2, 1.0, 0.0) * columns["true"]
        values = (0.5 + 0.5 * TIME) * columns["true"] + rng.normal(size=N)
        found = judged(toy.problem(values, columns), "late")
        assert found.point.model.causes == ("true",)
        assert set(found.p) == {"true"}


def test_a_cause_that_only_looks_like_the_change_of_another_is_dropped():
    for seed in range(5):
        rng = np.random.default_rng(seed)
        columns = columns_of(rng, "true", "other")
        columns["weak battery"] = STEP * columns["true"]
        values = (0.5 + 0.4 * TIME) * columns["true"] + rng.normal(size=N)
        found = judged(toy.problem(values, columns), "true", "weak battery")
        assert found.point.model.causes == ("true",)


def test_one_cause_that_changes_stands_for_two_that_change_together():
    """No exchange of one for another leads there: beside either of the two it explains half."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        columns = columns_of(rng, "left", "right")
        columns["both"] = columns["left"] + columns["right"]
        values = (0.5 + 0.4 * TIME) * columns["both"] + rng.normal(size=N)
        found = judged(toy.problem(values, columns), "left", "right")
        assert found.point.model.causes == ("both",)
        assert set(found.p) == {"both"}


def test_parts_hold_every_block_once():
    problem = toy.problem(np.zeros(N), {})
    masks = np.array(parts(problem))
    assert (masks.sum(axis=0) == 1).all()
    assert masks.any(axis=1).all()
    assert course(problem).min() == -1.0
    assert course(problem).max() == 1.0


def test_what_changes_along_the_log_has_no_one_value():
    point = SimpleNamespace(model=toy.model("a", "b"))
    found = JudgedStage(
        None, None, point, point, {}, [], {"a": 1e-4}, None, scrubs=False
    )
    assert found.lasting.causes == ("b",)
