"""Search for the shape of a cause: the value of a delay or a limit, the edge of a region."""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import replace

import numpy as np

from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.decide.trial import Trial, cost, possible
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.thresholds import (
    CLOCK_STRIDE,
    FAR_OFF,
    NOISE_ERROR,
    PROMISING,
)

FIRST_STRIDE, LAST_STRIDE = 0.4, 0.004
SHIFTS_M = (0.6, 0.3, 0.15, 0.08, 0.04, 0.02)


def searched(
    problem: Problem, point: Point, starts: Sequence[Candidate]
) -> tuple[Candidate, tuple[float, ...]]:
    """Return the best of some starts of a cause, and a value near it that is better still.

    The deviance of a delay or a limit has steps: its slope does not show where the minimum is.
    """

    def deviance(c: Candidate, theta: float) -> float:
        value = min(max(theta, c.low[0]), c.high[0])
        return problem.point(point.model.plus(c, (value,)), point.poses).deviance

    starts = [c for c in starts if not c.linear]
    begin = [(c, theta) for c in starts for theta in c.start]
    begin += [(starts[0], theta) for theta in starts[0].tried]
    tried = [(deviance(c, theta), c, theta) for c, theta in begin]
    least, best, theta = min(tried, key=lambda item: item[0])
    far = theta if best.is_limit else theta - best.null[0]
    stride = FIRST_STRIDE
    last = CLOCK_STRIDE if traits_of(best.cause).adds_up else LAST_STRIDE
    while stride > last:
        for factor in (1.0 + stride, 1.0 / (1.0 + stride)):
            moved = theta + far * (factor - 1.0)
            found = deviance(best, moved)
            if found < least:
                least, theta, far = found, moved, far * factor
                break
        else:
            stride *= 0.4
    return best, (min(max(theta, best.low[0]), best.high[0]),)


def refined(
    problem: Problem, point: Point, trials: Sequence[Trial], pool: Executor
) -> list[Trial]:
    """Search the shapes of those trials that could win with a better one; sort, the best first.

    If the best trial explains a gross misfit nearly whole, no shape of another can do better.
    """
    most = max((trial.gain for trial in trials), default=0.0)
    explained = point.is_gross and point.deviance - most < NOISE_ERROR * len(point.left)
    least = most if explained else PROMISING * most

    def best_shape(trial: Trial) -> Trial | None:
        if trial.candidate.moved is None or trial.gain < least:
            return trial
        moved = refine(problem, trial.point, len(trial.point.model.fitted) - 1)
        if not possible(moved):
            return None
        candidate, gain = (
            moved.model.fitted[-1].candidate,
            point.deviance - moved.deviance,
        )
        return replace(trial, candidate=candidate, point=moved, gain=gain)

    out = [trial for trial in pool.map(best_shape, trials) if trial is not None]
    return sorted(out, key=lambda t: -(t.gain - cost(t.candidate, t.gain)))


def refine(problem: Problem, point: Point, index: int) -> Point:
    """Search the shape of one cause: a region's edge is moved as long as it explains more."""
    for shift_m in SHIFTS_M:
        for side in (1.0, -1.0):
            f = point.model.fitted[index]
            assert f.candidate.moved is not None
            moved = point.model.swapped(
                index, f.candidate.moved(side * shift_m), f.theta
            )
            trial = fit(problem, moved, point, iterations=2)
            if _unexplained(trial) < _unexplained(point) - 0.1:
                point = trial
                break
    return point


def _unexplained(point: Point) -> float:
    """Return the deviance in which a few blocks that are far off count little.

    Where the robot nearly missed an edge, a centimetre decides whether its replay crosses it.
    """
    used = point.loss[point.loss > 0.0]
    return float(np.minimum(used, FAR_OFF * np.median(used)).sum())
