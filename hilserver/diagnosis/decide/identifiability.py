"""What the data cannot tell apart: accepted causes against rivals that could imitate them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.decide.promise import ModelExchange
from hilserver.diagnosis.decide.trial import Trial, cost, possible
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.fitting import fit, fit_without
from hilserver.diagnosis.regression.linear import basis, cosine, orthogonal
from hilserver.diagnosis.regression.problem import Point, Problem, apart
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.thresholds import (
    CLEARLY_SE,
    GROUP_COSINE,
    INEXACT,
    LEAST_GAIN,
    RIVAL_CLEAR_Z,
    RIVAL_COSINE,
    TIE,
)

MOST_SWAPS: Final = 4  # exchanges in a row


@dataclass
class Rival:
    """A cause in place of another."""

    candidate: Candidate
    point: Point
    # of the sensitivities, without what the other accepted causes explain; or of the effects at
    # their fitted sizes, if these are more alike, see `likeness`
    cosine: float
    # additional deviance that it leaves, including a penalty per parameter
    worse: float
    z: float  # significance of the difference over the blocks, see `deviations`
    gross: bool  # the accepted cause leaves far more than noise
    tie: float = TIE  # additional deviance that does not count

    @property
    def fitted(self) -> Fitted:
        """The cause with its fitted values."""
        return next(f for f in self.point.model.fitted if f.candidate is self.candidate)

    @property
    def close(self) -> bool:
        """Whether it explains the data about as well as the accepted cause."""
        return self.worse < self.tie or self.z < RIVAL_CLEAR_Z

    @property
    def ties(self) -> bool:
        """Whether the data cannot tell it from the accepted cause.

        Where only noise is left, less similar causes can be distinguished. Where far more is left,
        something unknown moves the robot as well, and may be what makes one of the two fit.
        """
        return self.close and self.cosine > (
            RIVAL_COSINE if self.gross else GROUP_COSINE
        )

    @property
    def wins(self) -> bool:
        """Whether it explains the data better."""
        return self.worse < -0.5


def cosines(library: Library, point: Point, index: int) -> Array:
    """Return the |cos| between an accepted cause and the best imitation by every candidate.

    What the other accepted causes explain is removed from both.
    """
    problem, f = library.problem, point.model.fitted[index]
    columns = problem.accepted(point)
    assert columns is not None
    columns = columns[library.blocks.order]
    others, mine = apart(point, columns, index)
    if not f.candidate.linear:
        mine = columns[:, point.model.slices[index].start]
    mine = orthogonal(mine, others)
    base = basis(others)
    theirs = np.ascontiguousarray(library.columns.T, dtype=np.float64)
    along, with_base = theirs @ mine, theirs @ base
    out = np.zeros(len(library.candidates))
    norm = float(mine @ mine) + 1e-300
    for i in range(len(library.candidates)):
        rows = np.flatnonzero(library.owner == i)[:2]
        block = theirs[rows]
        gram = block @ block.T - with_base[rows] @ with_base[rows].T
        scale = np.sqrt(np.maximum(np.diag(block @ block.T), 1e-300))
        inverse = np.linalg.pinv(gram / np.outer(scale, scale), rcond=1e-6)
        cross = along[rows] / scale
        out[i] = np.sqrt(max(float(cross @ inverse @ cross), 0.0) / norm)
    return np.minimum(out, 1.0)


def explained(problem: Problem, point: Point, index: int) -> float:
    """Return about how much deviance an accepted cause saves in addition to the others."""
    columns = problem.accepted(point)
    if columns is None or not point.model.fitted[index].candidate.linear:
        return 0.0
    others, own = apart(point, columns, index)
    own = orthogonal(own, others)
    return float(own @ own)


def rivals(
    library: Library, point: Point, index: int, near: Sequence[Trial] = ()
) -> list[Rival]:
    """Fit every confusable rival in place of an accepted cause, each from its best start.

    Parameters
    ----------
    near : sequence of Trial
        Others that explained nearly as much when the cause was accepted. A large effect need not
        look like the slope of its cause: a limit has no effect until it is reached.
    """
    problem, taken = library.problem, point.model.causes
    best: dict[str, tuple[Candidate, tuple[float, ...], float]] = {}
    for c, alike in zip(
        library.candidates, cosines(library, point, index).tolist(), strict=True
    ):
        if c.cause in taken or alike < RIVAL_COSINE:
            continue
        if c.cause not in best or alike > best[c.cause][2]:
            best[c.cause] = c, c.beginning, alike
    more = [
        (t.candidate, t.theta, 0.0)
        for t in near
        if t.candidate.cause not in {*best, *taken}
    ]
    saved = explained(problem, point, index) if best or more else 0.0
    starts = (*best.values(), *more)
    tried = (_in_its_place(problem, point, index, saved, *start) for start in starts)
    found = [rival for rival in tried if rival is not None]
    unlike = [r for r in found if r.close and r.cosine <= GROUP_COSINE]
    without = fit_without(problem, point, index) if unlike else point
    for rival in unlike:  # their effects may be more alike than their slopes
        rival.cosine = max(rival.cosine, likeness(without, point, rival.point))
    return sorted(
        (r for r in found if r.ties or r.candidate.cause in best), key=lambda r: r.worse
    )


def _in_its_place(
    problem: Problem,
    point: Point,
    index: int,
    saved: float,
    c: Candidate,
    theta: tuple[float, ...],
    alike: float,
) -> Rival | None:
    """Return a candidate fitted in place of an accepted cause, or None if it is not possible."""
    trial = fit(problem, point.model.swapped(index, c, theta), point, iterations=5)
    if not possible(trial):
        return None
    difference = trial.loss - point.loss
    penalty = cost(c, saved) - cost(point.model.fitted[index].candidate, saved)
    worse = float(difference.sum()) + penalty
    # Where not even their slopes differ, what is left is how exact the forms are.
    is_twin = saved * (1.0 - alike * alike) < TIE
    tie = max(TIE, INEXACT * saved) if is_twin else TIE
    return Rival(
        c, trial, alike, worse, deviations(difference, penalty), point.is_gross, tie
    )


def likeness(without: Point, one: Point, other: Point) -> float:
    """Return the |cos| between the changes that two models make to one that has neither cause."""
    return cosine(without.left - one.left, without.left - other.left)


def deviations(difference: Array, more: float = 0.0) -> float:
    """Return how clearly the blocks' differences of deviance have one sign: sum over its error.

    They are taken as they are or bounded, whichever is clearer: if a cause changes along the log,
    the half of the blocks that its mean fits worse would outvote the others.
    """
    bounded = np.clip(difference, -LEAST_GAIN, LEAST_GAIN)
    return max(
        float((d.sum() + more) / (np.sqrt((d**2).sum()) + 1e-9))
        for d in (difference, bounded)
    )


def with_best_rivals(
    library: Library, point: Point, near: Mapping[str, Sequence[Trial]] | None = None
) -> tuple[Point, dict[str, list[Rival]]]:
    """Swap causes for better rivals until none is left; return the rivals that tie.

    A rival that leaves less deviance, but larger errors on held-out blocks, is not better.

    Parameters
    ----------
    near : mapping of str to sequence of Trial, optional
        By accepted cause, see `rivals`.
    """
    near = near or {}
    for _ in range(MOST_SWAPS):
        ties: dict[str, list[Rival]] = {}
        swapped = None
        for index, f in enumerate(point.model.fitted):
            found = rivals(library, point, index, near.get(f.candidate.cause, ()))
            if found and found[0].wins and not found[0].ties:
                if ModelExchange(library.problem, point, found[0].point).harms:
                    found = found[1:]
                else:
                    swapped = found[0].point
                    break
            ties[f.candidate.cause] = [r for r in found if r.ties]
        if swapped is None:
            return point, ties
        point = swapped
    return point, ties


def prune(problem: Problem, point: Point) -> Point:
    """Drop causes that the others have made superfluous, the weakest first."""
    while point.model.fitted:
        less = [
            fit_without(problem, point, index)
            for index in range(len(point.model.fitted))
        ]
        weakest = min(less, key=lambda other: float((other.loss - point.loss).sum()))
        saved = weakest.loss - point.loss
        if float(saved.sum()) > LEAST_GAIN and deviations(saved) > CLEARLY_SE:
            break
        point = weakest
    return point
