"""Each number that decides about a cause: a case on either side of it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hilserver.diagnosis import thresholds as at
from hilserver.diagnosis.catalogue.library import pose_candidates
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.compare.differences import Difference
from hilserver.diagnosis.decide import revision, scrubbing, structure, trial
from hilserver.diagnosis.decide.drift import changing_alike, left_by_changes
from hilserver.diagnosis.decide.identifiability import Rival, prune
from hilserver.diagnosis.decide.unknown import Family
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis import toy
from tests.diagnosis.decide.test_first_choice import selected

LESS, MORE = 0.9, 1.1
NONE = np.zeros((0, 3))
N = 2000


def point_of(*fitted):
    blank = np.zeros(1)
    return Point(Model(tuple(fitted)), NONE, blank, blank, blank, blank)


def of_a_machine(deviations):
    return not trial.implausible(
        Fitted(toy.candidate("a", prior=0.1), (0.1 * deviations,))
    )


def rival(cosine=0.99, worse=0.0, z=0.0, *, gross=False):
    return Rival(toy.candidate("b"), point_of(), cosine, worse, z, gross)


def made_by_tyres(late_s):
    late = next(c for c in pose_candidates(None) if traits_of(c.cause).delays_turn)
    return scrubbing.late_turn(point_of(Fitted(late, (late_s,)))) is not None


def explains(left):
    """A cause that leaves a share of what there was, all of it far more than noise."""
    rng = np.random.default_rng(1)
    columns = {"a": rng.normal(size=N)}
    rest = rng.normal(size=N)
    size = 100.0
    values = size * (np.sqrt(1.0 - left) * columns["a"] + np.sqrt(left) * rest)
    return not failed(values, columns)


def no_gross_misfit(variance):
    rng = np.random.default_rng(2)
    columns = {"a": 0.01 * rng.normal(size=N)}
    return not failed(np.sqrt(variance) * rng.normal(size=N), columns)


def failed(values, columns):
    problem = toy.problem(values, columns)
    library, base = toy.library(problem)
    point = fit(problem, toy.model("a"), base)
    return revision.fails(Prepared(problem, library, base), point)


def stays(deviance):
    """A cause beside another one, by what it saves."""
    columns = {"a": np.zeros(N), "b": np.zeros(N)}
    columns["a"][::2], columns["b"][1::2] = 1.0, 1.0
    values = columns["a"] + np.sqrt(deviance / (N / 2)) * columns["b"]
    problem = toy.problem(values, columns)
    point = fit(problem, toy.model("a", "b"), problem.point(Model(), NONE))
    return "b" in prune(problem, point).model.causes


def holds(deviance):
    """A cause on blocks that it was not fitted to, by what it saves."""
    columns = {"a": np.ones(N)}
    problem = toy.problem(np.full(N, np.sqrt(deviance / N)), columns)
    before = problem.point(Model(), NONE)
    point = fit(problem, toy.model("a"), before)
    return trial.holds(problem, before, point)


def structure_holds(deviance):
    column = np.ones((N, 1))
    problem = toy.problem(np.full(N, np.sqrt(deviance / N)), {})
    return structure.holds_out(problem, column, problem.point(Model(), NONE).left)


def structure_instead(better):
    """A column in the place of a cause, by the deviance that it saves more."""
    rng = np.random.default_rng(4)
    own, other = rng.normal(size=(2, N))
    other -= own * float(other @ own) / float(own @ own)
    other *= np.sqrt(better / float(other @ other))
    problem = toy.problem(own + other, {"a": own})
    point = fit(problem, toy.model("a"), problem.point(Model(), NONE))
    family = Family("time", ("t_s",), (own + other)[:, None])
    return structure.imitated(problem, point, [family]) is not None


def substitute(cosine):
    """A column that explains more and leaves something to the cause, by how alike they are."""
    rng = np.random.default_rng(5)
    own, other = rng.normal(size=(2, N))
    other -= own * float(other @ own) / float(own @ own)
    other *= np.sqrt(float(own @ own) / float(other @ other))
    column = 10.0 * (cosine * own + np.sqrt(1.0 - cosine**2) * other)
    problem = toy.problem(column + 5.0 * own, {"a": own})
    point = fit(problem, toy.model("a"), problem.point(Model(), NONE))
    family = Family("t", ("t_s",), column[:, None])
    return structure.imitated(problem, point, [family]) is not None


def superfluous(share):
    """A column that explains far more but is not like a cause, by what that explains beside it."""
    rng = np.random.default_rng(6)
    own, other = rng.normal(size=(2, N))
    other -= own * float(other @ own) / float(own @ own)
    other *= np.sqrt(float(own @ own) / float(other @ other))
    column = 0.5 * own + np.sqrt(0.75) * other
    # the cause is left with 0.75 of its square beside the column, and has (0.5 + left)^2 alone
    left = np.sqrt(share) * 5.0 / (np.sqrt(0.75) - np.sqrt(share))
    problem = toy.problem(10.0 * column + left * own, {"a": own})
    point = fit(problem, toy.model("a"), problem.point(Model(), NONE))
    family = Family("t", ("t_s",), column[:, None])
    return structure.imitated(problem, point, [family]) is not None


def possible(beyond_sd=0.0, beyond_share=0.0):
    """The value of one of two logs, beyond what a machine can have."""
    c = replace(toy.candidate("a"), low=(0.0,), high=(1.0,))
    value = 1.0 + 0.1 * beyond_sd
    if beyond_share:
        value = 1.0 / (1.0 - beyond_share)
    error = 0.1 if beyond_sd else 0.0
    return Difference(
        c, "drive", 0, (0.0, value), (error, error), 0.001, 50.0, 9.0
    ).is_possible


def scrubbing_tyres(gain):
    turns = next(c for c in pose_candidates(None) if traits_of(c.cause).scrubs_as)
    log = SimpleNamespace(has=lambda *_: True)
    problem = SimpleNamespace(stage=SimpleNamespace(log=log, robot=RobotParameters()))
    unknown = SimpleNamespace(family=SimpleNamespace(regressors=(scrubbing.TURNING,)))
    return scrubbing.scrubs(problem, point_of(Fitted(turns, (gain,))), [unknown])


def causes_named(number):
    rng = np.random.default_rng(10)
    columns = {name: toy.smooth(rng, 4000) * 20.0 for name in "abcdefgh"[:number]}
    values = sum(columns.values()) + rng.normal(size=4000)
    return len(selected(values, columns).point.model.fitted) == number


def changes_alike(worse):
    """A rival of a cause that changes along the log, by the deviance that it leaves more."""
    rng = np.random.default_rng(11)
    own, other = rng.normal(size=(2, N))
    other -= own * float(other @ own) / float(own @ own)
    other *= np.sqrt(worse / float(other @ other))
    time = np.linspace(-1.0, 1.0, N)
    problem = toy.problem((1.0 + time) * own + other, {"a": own + other, "b": own})
    start = problem.point(Model(), NONE)
    a, b = (fit(problem, toy.model(name), start) for name in "ab")
    least, found = (left_by_changes(problem, p.model, p) for p in (a, b))
    tie = Rival(b.model.fitted[0].candidate, b, 1.0, 0.0, 0.0, gross=False)
    assert found > least
    return found - least, bool(changing_alike(problem, a, [tie]))


def structure_found(gain, *, n=N, explained=0.0):
    rng = np.random.default_rng(12)
    column = rng.normal(size=n)
    column *= np.sqrt(gain / float(column @ column))
    problem = toy.problem(column, {})
    family = Family("turn", ("velocity.angular_rad_s",), column[:, None])
    point = problem.point(Model(), NONE)
    return bool(structure.remaining(problem, point, rng, [family], explained))


def said_although_few_blocks(blocks):
    """All that is missed is in one of them."""
    rng = np.random.default_rng(13)
    values = rng.normal(size=50 * blocks)
    values[:20] = 30.0
    column = np.where(np.arange(50 * blocks) < 20, 1.0, 0.0)
    problem = toy.problem(values, {})
    problem.stage.follows_setpoints = False
    family = Family("turn", ("velocity.angular_rad_s",), column[:, None])
    point = problem.point(Model(), NONE)
    return bool(structure.remaining(problem, point, rng, [family], 0.0))


def dominates(times):
    """A cause beside structure that explains something else."""
    columns = {"a": np.zeros(N), "b": np.zeros(N)}
    columns["a"][::2], columns["b"][1::2] = 1.0, 1.0
    problem = toy.problem(columns["a"] + columns["b"], columns)
    point = fit(problem, toy.model("a"), problem.point(Model(), NONE))
    family = Family("turn", ("t_s",), columns["b"][:, None])
    unknown = structure.Unknown(family, 9.0, 3.0, 1e-4, N / 2 / times)
    return not structure.without_unknown(problem, point, [unknown])


@pytest.mark.parametrize(
    ("decides", "holds", "fails"),
    [
        pytest.param(
            of_a_machine, 0.9 * at.SELECTION_PLAUSIBLE_SD, 1.1 * at.SELECTION_PLAUSIBLE_SD,
            id="SELECTION_PLAUSIBLE_SD",
        ),
        pytest.param(
            lambda worse: rival(worse=worse, z=9.0).close, LESS * at.TIE, MORE * at.TIE, id="TIE"
        ),
        pytest.param(
            lambda z: rival(worse=99.0, z=z).close, LESS * at.RIVAL_CLEAR_Z,
            MORE * at.RIVAL_CLEAR_Z, id="RIVAL_CLEAR_Z",
        ),
        pytest.param(lambda c: rival(c).ties, 0.96, 0.94, id="GROUP_COSINE"),
        pytest.param(lambda c: rival(c, gross=True).ties, 0.61, 0.59, id="RIVAL_COSINE"),
        pytest.param(
            made_by_tyres, LESS * at.SCRUBBING_LATE_S, MORE * at.SCRUBBING_LATE_S,
            id="SCRUBBING_LATE_S",
        ),
        pytest.param(explains, 0.8 * at.LEFT_SHARE, 1.2 * at.LEFT_SHARE, id="LEFT_SHARE"),
        pytest.param(no_gross_misfit, 0.9 * at.GROSS, 1.1 * at.GROSS, id="GROSS"),
        pytest.param(stays, MORE * at.LEAST_GAIN, LESS * at.LEAST_GAIN, id="LEAST_GAIN"),
        pytest.param(
            holds, MORE * at.SELECTION_LEAST_SAVED, LESS * at.SELECTION_LEAST_SAVED,
            id="SELECTION_LEAST_SAVED",
        ),
        pytest.param(
            structure_holds, MORE * at.REST_LEAST_GAIN, LESS * at.REST_LEAST_GAIN,
            id="REST_LEAST_GAIN",
        ),
        pytest.param(
            structure_instead, 2.0 * at.REST_LEAST_GAIN, 0.5 * at.REST_LEAST_GAIN,
            id="REST_LEAST_GAIN instead",
        ),
        pytest.param(substitute, MORE * at.RIVAL_COSINE, LESS * at.RIVAL_COSINE, id="substitute"),
        pytest.param(
            superfluous, 0.5 * at.LEFT_SHARE, 2.0 * at.LEFT_SHARE, id="LEFT_SHARE beside"
        ),
        pytest.param(
            lambda sd: possible(beyond_sd=sd), 0.5 * at.FAR_SD, 2.0 * at.FAR_SD, id="FAR_SD"
        ),
        pytest.param(
            lambda share: possible(beyond_share=share), LESS * at.COMPARE_INEXACT,
            MORE * at.COMPARE_INEXACT, id="COMPARE_INEXACT",
        ),
        pytest.param(
            scrubbing_tyres, MORE * at.SCRUBBING_MUCH, LESS * at.SCRUBBING_MUCH,
            id="SCRUBBING_MUCH",
        ),
        pytest.param(
            causes_named, at.SELECTION_MOST_CAUSES, at.SELECTION_MOST_CAUSES + 1,
            id="SELECTION_MOST_CAUSES",
        ),
        pytest.param(
            lambda gain: structure_found(gain, n=80_000), MORE * 80_000 * at.LEAST_USEFUL,
            LESS * 80_000 * at.LEAST_USEFUL, id="LEAST_USEFUL",
        ),
        pytest.param(
            lambda gain: structure_found(gain, explained=40_000.0), MORE * 40_000 * at.INEXACT,
            LESS * 40_000 * at.INEXACT, id="INEXACT",
        ),
        pytest.param(
            said_although_few_blocks, at.FEWEST_BLOCKS, at.FEWEST_BLOCKS - 1, id="FEWEST_BLOCKS"
        ),
        pytest.param(dominates, MORE * at.DOMINANCE, LESS * at.DOMINANCE, id="DOMINANCE"),
    ],
)  # fmt: skip
def test_it_is_decided_at_its_number(decides, holds, fails):
    assert decides(holds)
    assert not decides(fails)


def test_a_rival_of_a_cause_that_changes_has_to_change_alike():
    alike, apart = changes_alike(0.5 * at.INSTEAD_LEAST_GAIN), changes_alike(500.0)
    assert alike[0] < at.INSTEAD_LEAST_GAIN < apart[0]
    assert alike[1]
    assert not apart[1]
