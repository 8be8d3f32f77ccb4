"""What becomes of causes that lose their names."""

from dataclasses import replace

import numpy as np
import pytest

from hilserver.diagnosis.decide.revision import fails, revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.decide.structure import Unknown
from hilserver.diagnosis.decide.unknown import Family
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.stages import Prepared
from tests.diagnosis import toy

N = 4000


def judged(monkeypatch, rng, values, column, structure, **how):
    """What is made of a cause and of a family of one column."""
    family = Family("turn", ("t_s",), structure[:, None])
    monkeypatch.setattr(
        "hilserver.diagnosis.decide.revision.families_of", lambda *_: [family]
    )
    problem = toy.problem(values, {"c": column})
    library, base = toy.library(problem)
    library.candidates[:] = [replace(library.candidates[0], **how)]
    return revised(
        Prepared(problem, library, base), select(problem, library, base, rng), rng
    )


def named(found):
    """The causes of a patch that have a name; the others only predict."""
    return {*found.point.model.causes} - found.effective


@pytest.mark.parametrize(
    ("least", "changes", "causes", "is_unknown"),
    [
        (0.9, False, {"c"}, False),
        (1.1, False, set(), False),  # it has a name, and is too small for it
        (1.1, True, set(), True),  # its mean does not say how large it is
    ],
)
def test_a_cause_too_small_for_its_name_is_no_unknown_structure(
    monkeypatch, least, changes, causes, is_unknown
):
    rng = np.random.default_rng(3)
    column = 5.0 * toy.smooth(rng, N)
    size = 0.2 + np.linspace(-3.0, 3.0, N) if changes else 1.0
    values = size * column + rng.normal(size=N)
    found = judged(monkeypatch, rng, values, column, size * column, least=least)
    assert named(found) == causes
    assert bool(found.unknown) == is_unknown


def test_structure_beside_a_cause_too_small_for_its_name_is_reported(monkeypatch):
    rng = np.random.default_rng(4)
    column, other = 5.0 * toy.smooth(rng, N), 5.0 * toy.smooth(rng, N)
    found = judged(
        monkeypatch, rng, column + other + rng.normal(size=N), column, other, least=1.5
    )
    assert named(found) == set()
    assert [u.family.name for u in found.unknown] == ["turn"]


@pytest.mark.parametrize(("size", "is_unknown"), [(10.0, True), (0.0, False)])
def test_a_gross_misfit_beside_a_cause_too_small_for_its_name_is_reported(
    monkeypatch, size, is_unknown
):
    """In so few blocks that no test finds it; one that the cause explains is none."""
    monkeypatch.setattr(toy.LinearStage, "follows_setpoints", False)
    rng = np.random.default_rng(5)
    column, other = 5.0 * toy.smooth(rng, N), np.zeros(N)
    other[1000:1100] = 1.0
    values = column + size * other + rng.normal(size=N)
    found = judged(monkeypatch, rng, values, column, other, least=1.5)
    assert named(found) == set()
    assert bool(found.unknown) == is_unknown


def test_a_cause_that_is_none_excuses_no_structure_by_its_own_inexactness(monkeypatch):
    """It is implausibly large: nothing is left whose form could be inexact."""
    rng = np.random.default_rng(6)
    column = np.where(np.arange(N) < N // 2, 60.0, 2.5) * toy.smooth(rng, N)
    faint = np.where(np.arange(N) < N // 2, 0.0, column)
    found = judged(
        monkeypatch, rng, column + rng.normal(size=N), column, faint, prior=0.01
    )
    assert found.point.model.causes == ()
    assert [u.family.name for u in found.unknown] == ["turn"]


@pytest.mark.parametrize(("said_sd", "stays"), [(2.4, False), (1.0, True)])
def test_a_misfit_that_passed_for_noise_takes_the_name_from_a_cause(said_sd, stays):
    """A cable's drag on the turn passed for noise of the gyro, and was named as a distortion.

    Without structure the same rest is noise.
    """
    rng = np.random.default_rng(7)
    column, other = 5.0 * toy.smooth(rng, N), 12.0 * toy.smooth(rng, N)
    rest = other if said_sd > 1.0 else 0.0 * other
    problem = toy.problem(
        column + rest + 0.3 * rng.normal(size=N), {"c": column}, noise_sd=said_sd
    )
    library, base = toy.library(problem)
    point = fit(problem, toy.model("c"), base)
    white = problem.shown(point, other[:, None])
    found = [Unknown(Family("turn", ("t_s",), white), 9.0, 4.0, 0.001, 1e3)]
    p = Prepared(problem, library, base)
    assert not fails(p, point), "all that is left looks like noise"
    assert fails(p, point, found) is not stays
