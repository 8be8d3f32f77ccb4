"""Causes whose size changes along the log: their sensitivity times the time."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Final

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.decide.identifiability import Rival
from hilserver.diagnosis.decide.selection import MOST_FITTED
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.fitting import DAMPED, fit
from hilserver.diagnosis.regression.intervals import own_share
from hilserver.diagnosis.regression.linear import SHORTEST, basis, orthogonal, saved
from hilserver.diagnosis.regression.problem import Point, Problem, apart
from hilserver.diagnosis.regression.screen import Blocks, adjusted, null_maxima, score
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.thresholds import (
    INSTEAD_LEAST_GAIN,
    LEFT_SHARE,
    REST_LEAST_GAIN,
    REST_LEVEL,
)

PARTS_OF_LOG: Final = 4  # of the log, each with a size and a trend of its own


@dataclass(frozen=True)
class Drifting:
    """A model and those of its causes that drift."""

    point: Point
    p: dict[str, float]  # of no change, by cause
    # deviance that separate sizes and trends in each part of the log save, compared with the model
    # before
    gain: float


def course(problem: Problem) -> Array:
    """Return the time of every sample, from -1 at the start to 1 at the end, shape (n, 1)."""
    clock = problem.stack.t_s
    middle, half = (
        0.5 * (clock.min() + clock.max()),
        0.5 * max(float(np.ptp(clock)), 1e-9),
    )
    return np.asarray((clock - middle) / half)[:, None]


def parts(problem: Problem) -> list[Mask]:
    """Return the blocks of each of `PARTS_OF_LOG` equal parts of the log."""
    stack, time = problem.stack, course(problem)[:, 0]
    middle = stack.block_sums(time) / np.maximum(
        np.bincount(stack.block, None, stack.n_blocks), 1
    )
    number = np.clip(
        (0.5 * PARTS_OF_LOG * (middle + 1.0)).astype(int), 0, PARTS_OF_LOG - 1
    )
    return [number == k for k in range(PARTS_OF_LOG)]


def drifting(
    problem: Problem, point: Point, rng: np.random.Generator
) -> dict[str, float]:
    """Return accepted causes whose value changes along the log, with their p.

    A change that the inexact form of a cause in the plant could explain does not count.
    """
    accepted = problem.accepted(point)
    if accepted is None:
        return {}
    blocks = Blocks.of(problem.stack.block, problem.stack.n_blocks)
    order = blocks.order
    s = score(
        (accepted * course(problem))[order], point.left[order], blocks, accepted[order]
    )
    maxima = null_maxima([s], rng)
    p = adjusted(s.t, maxima)

    def inexact(f: Fitted, mine: slice) -> float:
        own = accepted[:, mine] @ (np.asarray(f.theta) - np.asarray(f.candidate.null))
        return (2.0 * own_share(f.candidate.cause)) ** 2 * float(own @ own)

    return {
        f.candidate.cause: float(p[mine].min())
        for f, mine in zip(point.model.fitted, point.model.slices, strict=True)
        if p[mine].min() < REST_LEVEL
        and s.gain[mine].max() > max(REST_LEAST_GAIN, inexact(f, mine))
    }


def with_drift(library: Library, point: Point, rng: np.random.Generator) -> Drifting:
    """Return the model with a drifting cause wherever that explains more.

    A cause that drifts about its configured value has no mean effect, so that selection does not
    see it. Other drifts can look like part of the floor or a weaker battery.
    """
    first, stage = point, library.problem.stage
    # the error of satellites or a map changes along the log itself
    wanders = stage.log.pose_errors_last and stage.block == "kinematics"
    too_few = library.problem.stack.n_blocks < 2 * PARTS_OF_LOG
    if wanders or too_few:  # a change would be noise
        return Drifting(point, {}, 0.0)
    point = _taken_up(library, point, rng)
    p = drifting(library.problem, point, rng)
    suspects = set(p) or {c for c in first.model.causes if traits_of(c).of_a_place}
    if not suspects:
        return Drifting(point, {}, 0.0)
    other, least = _rearranged(library, first, point if p else first, suspects)
    if not p and suspects & set(other.model.causes):
        return Drifting(point, {}, 0.0)
    return Drifting(
        other, drifting(library.problem, other, rng), first.deviance - least
    )


def _singles(library: Library) -> tuple[list[int], Array]:
    """Return the linear candidates with one parameter and their columns, in the log's order."""
    chosen = [i for i, c in enumerate(library.candidates) if c.linear and c.n == 1]
    columns = np.empty((len(library.problem.stack), len(chosen)), order="F")
    columns[library.blocks.order] = library.columns[:, np.isin(library.owner, chosen)]
    return chosen, columns


def _beside(base: Array, column: Array) -> Array:
    """Return a column without what an orthonormal basis explains."""
    return np.asarray(column - base @ (base.T @ column))


def _taken_up(library: Library, point: Point, rng: np.random.Generator) -> Point:
    """Add the cause whose change alone explains most of what is left, if it is significant."""
    problem = library.problem
    chosen, columns = _singles(library)
    free = [k for k, i in enumerate(chosen)
            if library.candidates[i].cause not in point.model.causes]  # fmt: skip
    if not free:
        return point
    blocks, accepted = library.blocks, problem.accepted(point)
    order, time = blocks.order, course(problem)[:, 0]
    base = basis(np.empty((len(columns), 0)) if accepted is None else accepted)
    left, found = _beside(base, point.left), []
    for k in free:  # with a size of its own, or only the end that differs would count
        own = _beside(base, _beside(base, columns[:, k]))
        own = own[:, None] / max(float(np.sqrt(own @ own)), SHORTEST)
        change = _beside(own, _beside(base, columns[:, k] * time))
        found.append(score(change[order][:, None], _beside(own, left)[order], blocks))
    t, gain = (
        np.array([float(getattr(s, name)[0]) for s in found]) for name in ("t", "gain")
    )
    p = adjusted(t, null_maxima(found, rng))
    best = int(np.argmax(gain))
    if p[best] >= REST_LEVEL or gain[best] <= REST_LEAST_GAIN:
        return point
    c = library.candidates[chosen[free[best]]]
    return fit(problem, point.model.plus(c, c.beginning), point, iterations=3)


def _rearranged(
    library: Library, first: Point, point: Point, drift: set[str]
) -> tuple[Point, float]:
    """Exchange and drop causes; models are compared with separate sizes and trends in each part.

    Parameters
    ----------
    first : Point
        What was selected before a cause was added for its change alone.

    Returns
    -------
    Point
        With one size each.
    float
        Deviance with separate sizes and trends.
    """
    problem, taken = library.problem, point.model.causes
    accepted = problem.accepted(point)
    assert accepted is not None
    cost = partial(left_by_changes, problem, start=point)
    model, least = point.model, cost(point.model)
    for index, f in enumerate(point.model.fitted):
        if f.candidate.cause not in drift:
            continue
        others, own = apart(point, accepted, index)
        best = _by_change(library, orthogonal(point.left + own, others), others)
        for c in [c for c in best if c.cause not in taken][:MOST_FITTED]:
            if c.cause in model.causes:  # taken in place of another
                continue
            other = model.swapped(index, c, c.beginning)
            found = cost(other)
            if found < least - INSTEAD_LEAST_GAIN:
                model, least = other, found
    drift = {
        new.candidate.cause
        for new, old in zip(model.fitted, point.model.fitted, strict=True)
        if old.candidate.cause in drift
    }
    model, least = _without_stand_ins(problem, model, first, drift, cost, least)
    model, least = _one_for_all(library, model, first, cost, least)
    if model is not point.model:
        point = fit(problem, model, point, iterations=5)
    return point, least


def left_by_changes(problem: Problem, model: Model, start: Point) -> float:
    """Return the deviance of a model with separate sizes and trends in each part of the log."""
    return sum(_left_in(problem, model, start, mask) for mask in parts(problem))


def changing_alike(
    problem: Problem, point: Point, rivals: Sequence[Rival]
) -> list[Rival]:
    """Return the rivals whose change along the log explains as much as that of an accepted cause.

    With one size each, the misfit would be far larger than the difference between the causes.
    """
    most = left_by_changes(problem, point.model, point) + INSTEAD_LEAST_GAIN
    return [
        r for r in rivals if left_by_changes(problem, r.point.model, r.point) < most
    ]


def _left_in(problem: Problem, model: Model, start: Point, mask: Mask) -> float:
    """Return the deviance of some blocks, with their own sizes and linear trends there."""
    point = fit(problem, model, start, rows=mask, iterations=3)
    left = float(point.loss[mask].sum())
    columns, rows = problem.accepted(point), mask[problem.stack.block]
    if columns is None or not rows.any():
        return left
    trend = columns[rows] * course(problem)[rows]
    return left - saved(orthogonal(trend, columns[rows]), point.left[rows], DAMPED)


def _without_stand_ins(
    problem: Problem,
    model: Model,
    first: Point,
    drift: set[str],
    cost: Callable[[Model], float],
    least: float,
) -> tuple[Model, float]:
    """Drop causes that stood in for the change of another: with it they explain next to nothing.

    A selected cause must keep a share of what it explains alone; a cause that was added for its
    change, a share of what all changes explain.
    """
    while len(model.fitted) > 1:
        whole = fit(problem, model, first, iterations=4)
        shares = []
        for index, f in enumerate(model.fitted):
            less = model.without(index)
            alone = fit(problem, less, whole, iterations=3).deviance - whole.deviance
            beside = cost(less) - least
            if f.candidate.cause not in first.model.causes:
                alone = max(alone, first.deviance - least)
            share = beside / max(alone, 1e-9)
            shares.append(share if drift - {f.candidate.cause} else np.inf)
        weakest = int(np.argmin(shares))
        if shares[weakest] > LEFT_SHARE:
            break
        model = model.without(weakest)
        least = cost(model)
    return model, least


def _one_for_all(
    library: Library,
    model: Model,
    first: Point,
    cost: Callable[[Model], float],
    least: float,
) -> tuple[Model, float]:
    """Return one cause in place of several if it explains as much as they do together."""
    if len(model.fitted) < 2:
        return model, least
    problem = library.problem
    target = problem.point(Model(), first.poses).left
    for c in _by_change(library, target, None)[:MOST_FITTED]:
        other = Model().plus(c, c.beginning)
        found = cost(other)
        if found < least + INSTEAD_LEAST_GAIN:
            return other, found
    return model, least


def _by_change(
    library: Library, target: Array, others: Array | None
) -> list[Candidate]:
    """Return the linear candidates, those whose size and trend explain most of a target first."""
    chosen, columns = _singles(library)
    time = course(library.problem)
    gains = [
        (
            saved(
                orthogonal(np.column_stack([own, own * time]), others), target, DAMPED
            ),
            i,
        )
        for i, own in zip(chosen, columns.T[:, :, None], strict=True)
    ]
    return [library.candidates[i] for _, i in sorted(gains, reverse=True)]
