"""What predicts better although no cause can be asserted: the rung below a name."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.effective import recurs, same_sign
from hilserver.diagnosis.decide.revision import revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.findings.naming import named_findings
from hilserver.diagnosis.findings.nested import answers_of, confirmed
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.findings import Verdict
from tests.diagnosis import toy

N = 8000
CAUSE, TWIN = "process_gain", "viscous_load"


@pytest.fixture(autouse=True)
def no_families(monkeypatch):
    """A sum of columns has no motion that an unknown structure could depend on."""
    monkeypatch.setattr(
        "hilserver.diagnosis.decide.revision.families_of", lambda *_: []
    )


def drawn(size, much, seed=3):
    """A column that a cause explains, and much more that none does."""
    rng = np.random.default_rng(seed)
    column, other = 20.0 * toy.smooth(rng, N), toy.smooth(rng, N, 1500)
    return size * column + much * other / other.std() + rng.normal(size=N), column


def judged(values, column, **how):
    problem = toy.problem(values, {CAUSE: column, TWIN: -2.0 * column})
    library, base = toy.library(problem, [CAUSE])
    library.candidates[:] = [replace(library.candidates[0], **how)]
    rng = np.random.default_rng(3)
    return revised(
        Prepared(problem, library, base), select(problem, library, base, rng), rng
    )


def test_what_leaves_much_error_is_effective_and_in_the_patch():
    """It saves much, and much more remains: no name, but no worse prediction either."""
    j = judged(*drawn(1.0, 6.0))
    assert j.effective == {CAUSE}
    assert j.point.model.causes == (CAUSE,)
    assert j.point.model.fitted[0].theta[0] == pytest.approx(1.0, rel=0.2)
    (finding,) = named_findings(j)
    assert finding.verdict == Verdict.EFFECTIVE
    assert finding.causes == (CAUSE,)
    assert "acts as if" in finding.explanation
    assert "these data do not tell" in finding.explanation


def test_the_patch_of_each_half_holds_it_and_gains_on_the_other():
    j = judged(*drawn(2.0, 6.0))
    assert j.effective == {CAUSE}
    (answer,) = answers_of({"drive": j}, 0, 1)
    assert [f.verdict for f in answer.findings] == [Verdict.EFFECTIVE]
    assert answer.patch.gains(5.0, np.random.default_rng(0))["speed_rpm"].ratio > 1.01
    assert answer.possible(5.0, np.random.default_rng(0)) == {}


def test_where_it_explains_the_error_it_has_its_name():
    j = judged(*drawn(1.0, 0.0))
    assert j.effective == frozenset()
    assert named_findings(j)[0].verdict == Verdict.NAMED


@pytest.mark.parametrize("seed", range(6))
def test_without_an_effect_nothing_is_effective(seed):
    """However much else is wrong."""
    j = judged(*drawn(0.0, 6.0, seed))
    assert j.effective == frozenset()
    assert j.point.model.causes == ()


@pytest.mark.parametrize("how", [{"prior": 0.1}, {"high": (0.5,)}])
def test_what_no_machine_has_is_not_effective(how):
    j = judged(*drawn(1.0, 6.0), **how)
    assert j.effective == frozenset()
    assert j.point.model.causes == ()


@pytest.mark.parametrize(
    ("other", "is_sure"), [(1.0, True), (1.3, True), (0.2, False), (-0.5, False)]
)
def test_another_part_of_the_log_must_show_it_with_the_same_sign(other, is_sure):
    """On a real floor a turn gain differs from part to part, and gains in each."""
    values, column = drawn(1.0, 0.0)
    values[N // 2 :] += (other - 1.0) * column[N // 2 :]
    problem = toy.problem(values, {CAUSE: column})
    _, base = toy.library(problem)
    assert recurs(problem, fit(problem, toy.model(CAUSE), base), 0) == is_sure


def test_an_item_that_one_half_does_not_find_has_no_claim():
    j = judged(*drawn(1.0, 6.0))
    base = j.prepared.base
    blind = replace(j, point=base, whole=base, effective=frozenset())
    before = np.zeros(N)
    assert confirmed(j, (j, j), before).effective == {CAUSE}
    assert confirmed(j, (j, blind), before).effective == frozenset()
    assert confirmed(j, (j, blind), before).point.model.causes == ()
    assert confirmed(j, (j, None), before).effective == frozenset()
    assert confirmed(j, (None, None), before).effective == frozenset()


def test_what_is_too_small_for_a_name_still_predicts():
    j = judged(*drawn(1.0, 0.0), least=2.0)
    assert j.effective == {CAUSE}
    assert j.point.model.causes == (CAUSE,)


@pytest.mark.parametrize(("size", "is_found"), [(-0.5, True), (0.5, False)])
def test_a_half_may_find_an_item_under_another_name(size, is_found):
    """It asserts no cause, so all that counts is that it does the same."""
    j = judged(*drawn(1.0, 6.0))
    base, problem = j.prepared.base, j.prepared.problem
    point = problem.point(toy.model(TWIN).with_theta(np.array([size])), base.poses)
    half = replace(j, point=point, whole=point, effective=frozenset({TWIN}))
    found = confirmed(j, (j, half), np.zeros(N))
    assert found.effective == ({CAUSE} if is_found else frozenset())
    assert found.alike[CAUSE] == ({CAUSE, TWIN} if is_found else frozenset())


def test_all_fits_of_an_item_point_the_same_way():
    c = toy.candidate(CAUSE)
    one, other, away = (Fitted(c, (size,)) for size in (0.1, 0.3, -0.1))
    assert same_sign((one, other))
    assert not same_sign((one, other, away))
