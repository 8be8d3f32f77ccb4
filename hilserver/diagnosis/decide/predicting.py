"""What predicts: causes that have a name, and columns without one that held-out blocks confirm.

A name needs enough blocks that show the cause, and a size that machines have. A prediction only
needs held-out errors to fall. So a column may stay in the model, or be added to it, without a name:
it is neither a finding nor a term of the patch.
"""

from collections.abc import Iterable
from functools import partial
from typing import Final

from hilserver.diagnosis.decide.promise import ModelExchange
from hilserver.diagnosis.decide.selection import MOST_FITTED, attempt, best_starts
from hilserver.diagnosis.decide.trial import holds, implausible
from hilserver.diagnosis.regression.by_ends import fit_by_ends
from hilserver.diagnosis.regression.gain import HORIZON_S
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.schema.decisions import Decision
from hilserver.diagnosis.thresholds import LEAST_GAIN, SELECTION_MOST_CAUSES

STAYS: Final = "not named, but kept: held-out errors would grow without it"
COMES: Final = (
    "shown by too few blocks to be named, but kept: held-out blocks confirm it"
)


def before_settling(
    problem: Problem, point: Point, before: Iterable[Point], rows: list[Decision]
) -> Point:
    """Return one of the models from before causes lost their names, if it predicts better.

    A cause may lose its name because something else explains as much, or because it is too large or
    too small. If it helps on held-out blocks, it stays as a column without a name.
    """
    whole, harm = point, None
    for richer in before:
        if richer is whole:
            continue
        step = ModelExchange(problem, richer, whole)
        if step.harms:
            whole, harm = richer, step.gain
    nameless = [c for c in whole.model.causes if c not in point.model.causes]
    rows += [Decision(cause, "refused", harm, STAYS) for cause in nameless]
    return whole


def with_nameless(p: Prepared, whole: Point, rows: list[Decision]) -> Point:
    """Return a model with all further columns that held-out blocks confirm.

    Without any cause nothing is added. What remains of a drive is mostly the inexact form of its
    causes, see `Traits.abrupt`: columns would only imitate that.
    """
    if not whole.model.fitted or p.problem.stage.memoryless:
        return whole
    for _ in range(SELECTION_MOST_CAUSES):
        further = _further(p, whole)
        if further is None:
            break
        cause = further.model.causes[-1]
        rows.append(
            Decision(
                cause, "refused", ModelExchange(p.problem, whole, further).gain, COMES
            )
        )
        whole = further
    return whole


def halfway(problem: Problem, by_all: Point) -> Point:
    """Return a model halfway between its fit to all samples and that to the ends of free runs.

    The first errs by what it takes for noise, the second because it uses little of the data; their
    mean is closer than either. In long segments the noise is known, and all samples are best.
    """
    by_ends = fit_by_ends(problem, by_all, HORIZON_S) if problem.is_short else by_all
    if by_ends is by_all:
        return by_all
    theta = 0.5 * (by_all.model.theta() + by_ends.model.theta())
    return problem.point(by_all.model.with_theta(theta), by_all.poses)


def _further(p: Prepared, whole: Point) -> Point | None:
    """Return the model with the one confirmed column that explains most, if there is one."""
    problem, library = p.problem, p.library
    starts = best_starts(library.scores(whole), library, frozenset(whole.model.causes))
    fitted = partial(attempt, problem, whole, library, p=1.0, gross=whole.is_gross)
    trials = [
        trial
        for index, _ in starts[:MOST_FITTED]
        if (trial := fitted(index)) is not None
    ]
    for trial in sorted(trials, key=lambda trial: -trial.gain):
        point = trial.point
        if trial.gain <= LEAST_GAIN or implausible(point.model.fitted[-1]):
            continue
        step = ModelExchange(problem, whole, point)
        if step.helps and not step.harms and holds(problem, whole, point):
            return point
    return None
