"""The fit of a model's parameters: damped Gauss-Newton steps, re-linearised where necessary."""

from typing import Final

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.regression.free_poses import Bases
from hilserver.diagnosis.regression.linear import ridge
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Model

DAMPED: Final = 1e-6  # damping of the steps of a fit, see `linear`
# deviance; a step with a smaller expected gain is not taken
LEAST_EXPECTED: Final = 0.01
AS_EXPECTED: Final = 0.1
"""Share by which a step's gain may miss the linear one if the sensitivities are to be reused."""
ATTEMPTS: Final = 4
"""Steps that are tried, each without the blocks in which the previous one diverged."""


def fit(
    problem: Problem,
    model: Model,
    start: Point,
    *,
    rows: Mask | None = None,
    iterations: int = 6,
) -> Point:
    """Fit the parameters of a model.

    Parameters
    ----------
    start : Point
        Gives the initial poses, and the first sensitivities of causes with the same values.
    rows : ndarray of bool, shape (blocks,), optional
        Blocks that count; by default all.
    """
    known = model is start.model and start.noise is problem.noise
    point = start if known else problem.point(model, start.poses, pose_steps=0)
    if not model.fitted:
        return point
    used = np.ones(problem.stack.n_blocks, dtype=bool) if rows is None else rows
    raw = _columns_near(problem, point, start)
    taken = any(f in start.model.fitted for f in model.fitted)
    # none is of elsewhere
    fresh = not taken or np.array_equal(point.predicted, start.predicted)
    for more in reversed(range(iterations)):
        best, expected = _step(problem, point, raw, used)
        if expected < LEAST_EXPECTED or (best is None and fresh):
            break
        gained = 0.0 if best is None else float((point.loss - best.loss)[used].sum())
        point = best or point
        fresh = abs(gained - expected) > AS_EXPECTED * expected
        if fresh and more:
            raw = problem.whiten(problem.columns(point, point.model))
    return point


def fit_without(problem: Problem, point: Point, *causes: int) -> Point:
    """Return a model without some of its causes (by index), with the others fitted again."""
    return fit(problem, point.model.without(*causes), point, iterations=3)


def _columns_near(problem: Problem, point: Point, start: Point) -> Array:
    """Return whitened sensitivities, taken from the start for causes that are the same there."""
    model, theirs = point.model, start.model
    found = np.empty((len(problem.stack), len(model.theta())))
    new: list[int] = []
    for f, mine in zip(model.fitted, model.slices, strict=True):
        if f in theirs.fitted:
            at = theirs.slices[theirs.fitted.index(f)]
            found[:, mine] = problem.own_white(start)[:, at]
        else:
            new += range(mine.start, mine.stop)
    if new:
        found[:, new] = problem.whiten(problem.columns(point, model, new))
    return found


def _step(
    problem: Problem, point: Point, raw: Array, used: Mask
) -> tuple[Point | None, float]:
    """Return the point after a step that gains, if any, and the gain expected of it.

    A block in which a step does not follow its slope does not steer the next attempt: a robot that
    nearly missed the edge of a floor crosses it in one step and not in the other.

    Parameters
    ----------
    raw : ndarray, shape (n, k)
        Whitened sensitivities.
    """
    steering = used
    bases = problem.bases_at(point)
    white = problem.project(raw, bases)
    for _ in range(ATTEMPTS):
        found, expected, diverged = _attempted(
            problem, point, raw, white, bases, used, steering
        )
        diverged &= steering
        steering = steering & ~diverged
        few = 2 * steering.sum() < used.sum()
        if found is not None or expected < LEAST_EXPECTED or few or not diverged.any():
            break
    return found, expected


def _attempted(
    problem: Problem,
    point: Point,
    raw: Array,
    white: Array,
    bases: Bases | None,
    used: Mask,
    steering: Mask,
) -> tuple[Point | None, float, Mask]:
    """Return the same for the step that some blocks determine, and where it diverged."""
    low, high = point.model.borders()
    keep = slice(None) if steering.all() else steering[problem.stack.block]
    step, expected = ridge(white[keep], point.left[keep], DAMPED), 0.0
    diverged = np.zeros_like(used)
    for share in (1.0, 0.5, 0.2):
        theta = np.clip(point.model.theta() + share * step, low, high)
        away, poses = theta - point.model.theta(), point.poses
        explained = white @ away
        gains = problem.stack.block_sums(explained * (2.0 * point.left - explained))
        expected = float(gains[steering].sum())
        if expected < LEAST_EXPECTED:
            break
        if bases is not None:
            poses = poses + bases.step(point.white - raw @ away)
        trial = problem.point(point.model.with_theta(theta), poses, pose_steps=0)
        gained = point.loss - trial.loss
        if gained[used].sum() > 0.0:
            return trial, expected, diverged
        diverged |= np.abs(gained - gains) > AS_EXPECTED * expected
    return None, expected, diverged
