"""Intervals of fitted parameters that are valid under autocorrelation: they count blocks."""

from typing import Final

import numpy as np
from scipy import stats

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.regression import linear
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.thresholds import INEXACT

ROUNDED: Final = 0.3  # ticks: standard deviation of rounding to whole ticks


def own_share(cause: str) -> float:
    """Return the share of its size by which the plant's own form of a cause may be off."""
    return traits_of(cause).abrupt or INEXACT


def covariance(problem: Problem, point: Point, columns: Array) -> tuple[Array, int]:
    """Return the covariance of a model's parameters and its degrees of freedom.

    The larger of the sandwich over the blocks and the one that trusts the noise model.

    Parameters
    ----------
    columns : ndarray, shape (n, k)
        Whitened sensitivities, initial poses projected out (`Problem.accepted`).
    """
    n, k = problem.stack.n_blocks, columns.shape[1]
    sums = problem.stack.block_sums(columns * point.left[:, None])
    used = max(int(sums.any(axis=1).sum()), k + 2)
    level = point.deviance / max(len(point.left), 1)
    return linear.covariance(columns, sums, used, level), min(used, n) - k


def whole_covariance(
    problem: Problem, point: Point, columns: Array | None = None
) -> tuple[Array, int]:
    """Return the covariance of all fitted parameters, and its degrees of freedom.

    It includes the inexactness of the model's own form and the rounding of delays to whole ticks.

    Parameters
    ----------
    columns : ndarray, shape (n, k), optional
        `Problem.accepted`, if already known.
    """
    columns = problem.accepted(point) if columns is None else columns
    assert columns is not None
    cov, dof = covariance(problem, point, columns)
    causes = [f.candidate.cause for f in point.model.fitted for _ in f.theta]
    share = np.array([own_share(cause) for cause in causes])
    ticks = np.array([ROUNDED * traits_of(cause).whole_ticks for cause in causes])
    variance = np.diag(cov) + (share * point.model.theta()) ** 2
    if problem.is_short:  # see `halfway`: its additional variance (Hausman 1978)
        # one distance shows no correlation
        variance += linear.ridge(columns, point.left) ** 2
    np.fill_diagonal(cov, variance + (ticks * problem.stage.robot.period_s) ** 2)
    return cov, max(dof, 2)


def limits(theta: Array, cov: Array, dof: float | Array) -> Array:
    """Return the 95 % limits of all parameters, shape (k, 2)."""
    half = stats.t.ppf(0.975, dof) * np.sqrt(np.diag(cov))
    return np.stack([theta - half, theta + half], axis=1)
