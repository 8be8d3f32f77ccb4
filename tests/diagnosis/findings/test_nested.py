"""The cross-validated gain: what a half of the blocks judges was found without that half."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.revision import revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.findings import nested
from hilserver.diagnosis.findings.nested import cross_validated, judged_by_halves
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import Prepared, without
from hilserver.diagnosis.replay.stack import FOLD_RUNS
from hilserver.diagnosis.schema.findings import Finding, Verdict
from tests.diagnosis import toy
from tests.diagnosis.mutation import mutated

N = 3000
SEED = 3


@pytest.fixture(autouse=True)
def no_families(monkeypatch):
    """A sum of columns has no motion that an unknown structure could depend on."""
    monkeypatch.setattr(
        "hilserver.diagnosis.decide.revision.families_of", lambda *_: []
    )


def judged(values, columns):
    problem = toy.problem(values, columns)
    library, base = toy.library(problem)
    p = Prepared(problem, library, base)
    rng = np.random.default_rng(SEED)
    return revised(p, select(problem, library, base, rng), rng)


def drawn(sizes=(1.0, 1.0)):
    rng = np.random.default_rng(SEED)
    columns = {f"c{k}": 20.0 * toy.smooth(rng, N) for k in range(6)}
    effects = sum(
        size * column for size, column in zip(sizes, columns.values(), strict=False)
    )
    return effects + rng.normal(size=N), columns


def after(j):
    halves = judged_by_halves({"drive": j}, SEED, 1)["drive"]
    before = np.zeros(len(j.prepared.problem.stack))
    return cross_validated(j, halves, before).parts[0].after


def no_prediction_saw_its_half():
    values, columns = drawn()
    stack = toy.problem(values, columns).stack
    first = after(judged(values, columns))
    for half in (0, 1):
        rows = stack.half[stack.block] == half
        spoilt = values.copy()
        spoilt[rows] += 0.3 * columns["c3"][rows] + 0.3 * np.random.default_rng(
            9
        ).normal(size=rows.sum())
        again = after(judged(spoilt, columns))
        assert np.allclose(again[rows], first[rows], rtol=0.0, atol=1e-9), (
            "saw its own half"
        )
        assert not np.allclose(again[~rows], first[~rows], rtol=0.0, atol=1e-3), (
            "nothing was fed"
        )


def test_a_half_is_predicted_by_what_was_selected_and_fitted_without_it():
    no_prediction_saw_its_half()


def test_nested_halves_off():
    """Causes and sizes of the whole log are no cross-validated gain."""
    line = "halves.append(revised(p, selected, rng))"
    whole = "halves.append(judged[name])"
    with (
        mutated(nested.judged_by_halves, line, whole),
        pytest.raises(AssertionError, match="its own half"),
    ):
        no_prediction_saw_its_half()


def test_a_cause_of_one_half_gains_nothing_in_the_other():
    values, columns = drawn()
    stack = toy.problem(values, columns).stack
    columns["lure"] = np.where(stack.half[stack.block] == 0, 30.0 * toy.smooth(
        np.random.default_rng(4), N), 0.0)  # fmt: skip
    j = judged(values + 0.5 * columns["lure"], columns)
    assert "lure" in j.point.model.causes
    halves = judged_by_halves({"drive": j}, SEED, 1)["drive"]
    whole = cross_validated(j, halves, np.zeros(N))
    index = j.point.model.causes.index("lure")
    rows = stack.half[stack.block] == 0
    unseen = whole.without(frozenset({index}))[0]
    assert np.allclose(whole.parts[0].after[rows], unseen[rows], atol=0.05)


@pytest.mark.parametrize("seconds", [20.0, 60.0])
def test_no_noise_and_no_free_run_crosses_what_was_held_out(seconds):
    values = np.random.default_rng(0).normal(size=round(seconds / toy.PERIOD_S))
    stack = toy.problem(values, {}).stack
    assert len(np.unique(stack.pieces)) == FOLD_RUNS
    for half in (0, 1):
        part, rows = stack.without(half)
        assert set(stack.half[stack.block[rows]]) == {1 - half}
        assert np.array_equal(part.values, stack.values[rows])
        for _, _, run in part.runs():
            assert np.ptp(np.diff(part.t_s[run])) < 1e-6, "a run crosses a gap"
        assert set(part.fold) == {0, 1}
        assert part.block.max() == part.n_blocks - 1


def test_a_stage_without_samples_of_one_half_says_nothing():
    values, columns = drawn()
    j = judged(values, columns)
    stack = replace(
        j.prepared.problem.stack, half=np.zeros(j.prepared.problem.stack.n_blocks, int)
    )
    p = replace(j.prepared, problem=Problem(j.prepared.problem.stage.on(stack)))
    assert without(p, 0) is None
    assert without(p, 1) is None


def test_a_column_without_a_name_predicts_and_is_in_no_patch():
    values, columns = drawn()
    j = judged(values, columns)
    problem, base = j.prepared.problem, np.zeros(N)
    assert set(j.point.model.causes) == {"c0", "c1"}
    less = fit(problem, j.point.model.without(0), j.point)
    nameless = replace(j, point=less, whole=j.point)
    whole = cross_validated(nameless, (nameless, nameless), base)
    patch = cross_validated(nameless, (nameless, nameless), base, patched=True)
    assert np.allclose(whole.parts[0].after, j.point.predicted)
    assert np.allclose(patch.parts[0].after, less.predicted)
    assert whole.gains(5.0, np.random.default_rng(0))["speed_rpm"].ratio > 1.5


def test_what_corrects_the_log_is_no_gain_of_the_patch():
    """A clock is of this log."""
    values, columns = drawn()
    clock, turn = columns.pop("c0"), columns["c1"]
    j = judged(values, {"shift.nav": clock, **columns})
    assert set(j.point.model.causes) == {"shift.nav", "c1"}
    explained = cross_validated(
        j, judged_by_halves({"drive": j}, SEED, 1)["drive"], np.zeros(N)
    )
    (part,) = explained.parts
    assert not part.before.any(), "the configured plant"
    assert np.allclose(part.corrected, clock, atol=0.1), "the same, the clock corrected"
    assert np.allclose(part.after, clock + turn, atol=0.2)
    rng, noise = np.random.default_rng(0), values - clock - turn
    total = explained.gains(5.0, rng)["speed_rpm"]
    patch = explained.gains(5.0, rng, explained.corrected)["speed_rpm"]
    assert total.before == pytest.approx(np.abs(values).mean(), rel=0.02)
    assert patch.before == pytest.approx(np.abs(turn + noise).mean(), rel=0.02)
    assert total.after == patch.after == pytest.approx(np.abs(noise).mean(), rel=0.02)


def test_where_only_the_log_is_corrected_a_patch_gains_nothing():
    values, columns = drawn((1.0,))
    j = judged(values, {"shift.nav": columns.pop("c0"), **columns})
    assert j.point.model.causes == ("shift.nav",)
    explained = cross_validated(
        j, judged_by_halves({"drive": j}, SEED, 1)["drive"], np.zeros(N)
    )
    assert np.array_equal(explained.parts[0].corrected, explained.parts[0].after)
    (alone,) = explained.without(frozenset({0}))
    gain = explained.gains(5.0, np.random.default_rng(0), (alone,))["speed_rpm"]
    assert gain.ratio > 1.3, "the finding itself does gain"


def test_a_finding_says_how_many_halves_show_it():
    values, columns = drawn()
    j = judged(values, columns)
    blind = replace(j, whole=j.prepared.base)
    finding = Finding(verdict=Verdict.NAMED, causes=("c0",), block="drive")
    for halves, shown in (
        ((j, j), 2),
        ((j, blind), 1),
        ((None, j), 1),
        ((None, blind), 0),
    ):
        assert nested.in_halves(finding, halves).halves == shown
