"""Parameters fitted to what a gain is measured by: the errors at the end of free runs.

Least squares over all samples follows the whole course of a run, including transients, whose form
no cause has exactly. In short segments no noise model shows how much of the course that affects.
Users care where a run ends, so only that is fitted here, in absolute errors, which a few runs that
go completely wrong do not dominate. This uses less of the data, so it scatters more.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array
from hilserver.diagnosis.regression.gain import Windows, missed, windows
from hilserver.diagnosis.regression.linear import ridge
from hilserver.diagnosis.regression.problem import Point, Problem

# see `linear`: not every parameter affects the end of a run
DAMPED_BY_ENDS: Final = 1e-4
MOST_STEPS: Final = 12
CONVERGED: Final = 1e-3  # share of the cost; a smaller gain ends the iteration

Misses = Mapping[str, NDArray[Any]]  # by quantity, shape (runs,); a position is x + iy


def fit_by_ends(problem: Problem, start: Point, horizon_s: float) -> Point:
    """Return a model with the parameters whose free runs end nearest to the measurements.

    Parameters
    ----------
    start : Point
        The model fitted to all samples.
    horizon_s : float
        Length of the runs.
    """
    runs = windows(problem, horizon_s)
    if runs is None or not start.model.fitted:
        return start
    # usual misses are taken from the first model, once: otherwise the cost would change
    ends = _Ends(problem, runs, start.predicted)
    point, least = start, ends.cost(start.predicted)
    for _ in range(MOST_STEPS):
        step, found = ends.step(point), least
        for share in (1.0, 0.5, 0.2):  # as in `fitting`
            theta = np.clip(point.model.theta() + share * step, *point.model.borders())
            trial = problem.point(point.model.with_theta(theta), point.poses)
            if (found := ends.cost(trial.predicted)) < least:
                break
        if found >= least:
            break
        last = least - found < CONVERGED * least
        point, least = trial, found
        if last:
            break
    return point


class _Ends:
    """The ends of some free runs; misses count relative to the first model's median miss.

    Parameters
    ----------
    predicted : ndarray, shape (n,)
        By the first model.
    """

    def __init__(self, problem: Problem, runs: Windows, predicted: Array) -> None:
        self.problem, self.runs = problem, runs
        off = missed(problem, predicted, runs)
        self.scale = {
            k: max(float(np.median(np.abs(one))), 1e-9) for k, one in off.items()
        }

    def _off(self, predicted: Array) -> Misses:
        off = missed(self.problem, predicted, self.runs)
        return {key: one / self.scale[key] for key, one in off.items()}

    def cost(self, predicted: Array) -> float:
        """Return the sum of all misses: squared if they are small, absolute if large."""
        off = self._off(predicted).values()
        return float(sum(np.sum(np.sqrt(1.0 + np.abs(one) ** 2) - 1.0) for one in off))

    def step(self, point: Point) -> Array:
        """Return the step of a model's parameters that lowers the cost most, if all is linear."""
        off = self._off(point.predicted)
        # root of the weights of iteratively reweighted least squares, for misses and effects
        weight = {key: (1.0 + np.abs(one) ** 2) ** -0.25 for key, one in off.items()}
        sizes = [s for f in point.model.fitted for s in f.candidate.step]
        columns, effects = self.problem.columns(point, point.model).T, []
        for column, size in zip(columns, sizes, strict=True):
            moved = self._off(point.predicted + size * column)
            effects.append(_flat({k: (off[k] - moved[k]) / size for k in off}, weight))
        return ridge(np.stack(effects, axis=1), _flat(off, weight), DAMPED_BY_ENDS)


def _flat(off: Misses, weight: Mapping[str, Array]) -> Array:
    """Return all misses in one vector, both coordinates of a position, times their weights."""
    parts = [
        weight[key] * part for key, one in off.items() for part in (one.real, one.imag)
    ]
    return np.concatenate(parts)
