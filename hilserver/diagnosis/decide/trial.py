"""A trial: a candidate fitted together with the accepted causes, and the tests it must pass."""

from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.intervals import covariance
from hilserver.diagnosis.regression.linear import orthogonal
from hilserver.diagnosis.regression.problem import Point, Problem, apart
from hilserver.diagnosis.regression.screen import freedom_of, normal
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.thresholds import (
    INEXACT,
    SELECTION_LEAST_SAVED,
    SELECTION_PLAUSIBLE_SD,
    TIE,
)


@dataclass(frozen=True)
class Trial:
    """A candidate fitted together with the accepted causes."""

    candidate: Candidate
    point: Point
    gain: float
    p: float

    @property
    def theta(self) -> tuple[float, ...]:
        """Fitted values of the candidate's own parameters."""
        return self.point.model.fitted[-1].theta


def cost(candidate: Candidate, explained: float) -> float:
    """Return the deviance that a candidate must save to be better than a simpler one."""
    return TIE * candidate.weight + INEXACT * candidate.hidden * explained


def possible(point: Point) -> bool:
    """Return whether every parameter is inside its range and not at its edge."""
    return not any(map(at_bound, point.model.fitted))


def at_bound(f: Fitted) -> bool:
    """Return whether a parameter of a cause is at the edge of its range: it explains nothing."""
    ranges = zip(f.theta, f.candidate.low, f.candidate.high, strict=True)
    return any(not low < value < high for value, low, high in ranges)


def implausible(f: Fitted) -> bool:
    """Return whether a cause is larger than one would expect in any machine."""
    away = (abs(v - null) for v, null in zip(f.theta, f.candidate.null, strict=True))
    return max(away) > SELECTION_PLAUSIBLE_SD * f.candidate.prior


def worth_a_name(fitted: Fitted) -> bool:
    """Return whether a cause is as large as its least size."""
    away = (
        abs(v - null)
        for v, null in zip(fitted.theta, fitted.candidate.null, strict=True)
    )
    return max(away) >= fitted.candidate.least


def physical(point: Point) -> bool:
    """Return whether every cause is possible and worth a name."""
    return possible(point) and all(map(worth_a_name, point.model.fitted))


def holds(problem: Problem, before: Point, after: Point) -> bool:
    """Return whether a cause improves the blocks left out of its fit, both ways.

    Each half of the blocks is predicted from a fit on the other: together they must improve
    clearly, and neither may get worse.
    """
    fold = problem.stack.fold
    saved = []
    for test in (0, 1):
        train = fold != test
        if not train.any() or train.all():
            return True
        without = fit(problem, before.model, before, rows=train, iterations=2)
        point = fit(problem, after.model, after, rows=train, iterations=2)
        part = fold == test
        saved.append(float((without.loss - point.loss)[part].sum()))
    return sum(saved) > SELECTION_LEAST_SAVED and min(saved) > -1.0


def wald(problem: Problem, point: Point, index: int) -> float:
    """Return how far a fitted cause lies from its null, as a normal deviate.

    The test is of a factor on the whole effect of the cause. The slope at the fit says less about
    a cause that acts in jumps, such as at the edge of a floor that a robot nearly missed. Only
    blocks that separate the cause from the others count, see `screen.normal`.
    """
    columns = problem.accepted(point)
    assert columns is not None
    others, own = apart(point, columns, index)[0], problem.effect(point, index)
    information = problem.stack.block_sums(orthogonal(own, others) ** 2)
    used = not_alone(information)[problem.stack.block]
    cov, _ = covariance(problem, point, np.column_stack([others, own]) * used[:, None])
    return float(
        normal(cov[-1, -1] ** -0.5, freedom_of(information[not_alone(information)]))[()]
    )


def not_alone(information: Array) -> Mask:
    """Return which blocks count: not one with more information than all others together.

    Such a block is no evidence, and would hide that of the others.

    Parameters
    ----------
    information : ndarray, shape (blocks,)
        Of each block.
    """
    used = np.ones(len(information), dtype=bool)
    while (
        2.0 * (left := information[used]).max() > left.sum()
        and np.count_nonzero(left) > 1
    ):
        used &= information < left.max()
    return used


def own_error(problem: Problem, point: Point, before: float) -> float:
    """Return the deviance that the accepted causes may leave because their form is inexact.

    An effect that is off by a share of itself leaves the square of that share. Where wheels stick
    and break loose it leaves more: a tenth of the share already decides when they do. Twice the
    share is allowed, as in an interval.

    Parameters
    ----------
    before : float
        Deviance without any cause.
    """
    most = 0.0
    for index, f in enumerate(point.model.fitted):
        if share := traits_of(f.candidate.cause).abrupt:
            explained = max(before - point.deviance, 0.0)
            moves = (share, -share, 0.1 * share, -0.1 * share)
            found = (_moved_by(problem, point, index, move) for move in moves)
            most = max(most, share**2 * explained, *found)
    return 4.0 * most


def _moved_by(problem: Problem, point: Point, index: int, share: float) -> float:
    """Return the deviance between a model and the same model with one cause larger by a share."""
    f = point.model.fitted[index]
    theta = (
        v + share * (v - null)
        for v, null in zip(f.theta, f.candidate.null, strict=True)
    )
    moved = point.model.swapped(index, f.candidate, tuple(theta))
    other = problem.point(moved, point.poses, pose_steps=0)
    return float(((other.left - point.left) ** 2).sum())
