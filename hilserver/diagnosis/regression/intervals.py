"""Intervals of fitted parameters that hold under autocorrelation: they count blocks."""

import numpy as np
from scipy import stats

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.regression import linear
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.thresholds import INEXACT


def own_share(cause: str) -> float:
    """Return the share of its size by which the model's own form of a cause may be off."""
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
    problem: Problem, point: Point, extra: Array | None = None, columns: Array | None = None
) -> tuple[Array, int]:
    """Return the covariance of all parameters, with what the model's own form may cost.

    Parameters
    ----------
    extra : ndarray, shape (k,), optional
        Standard deviations to add for what is rounded (a delay to whole ticks).
    columns : ndarray, shape (n, k), optional
        `Problem.accepted`, where it is known already.
    """
    columns = problem.accepted(point) if columns is None else columns
    assert columns is not None
    cov, dof = covariance(problem, point, columns)
    fitted = point.model.fitted
    share = [own_share(f.candidate.cause) for f in fitted for _ in f.theta]
    variance = np.diag(cov) + (np.array(share) * point.model.theta()) ** 2
    if problem.is_short:  # see `halfway`: the variance that it has more (Hausman 1978)
        variance += linear.ridge(columns, point.left) ** 2  # one distance shows no correlation
    if extra is not None:
        variance += extra**2
    np.fill_diagonal(cov, variance)
    return cov, max(dof, 2)


def limits(theta: Array, cov: Array, dof: float | Array) -> Array:
    """Return the limits of 95 % of all parameters, shape (k, 2)."""
    half = stats.t.ppf(0.975, dof) * np.sqrt(np.diag(cov))
    return np.stack([theta - half, theta + half], axis=1)
