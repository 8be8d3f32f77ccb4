"""The value of a drifting parameter over time, for the report."""

from typing import Final

import numpy as np
from scipy import stats

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG, unit_of
from hilserver.diagnosis.regression import linear
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.evidence import Course

WINDOWS: Final = 8
FEWEST_SEGMENTS: Final = 6
"""With this many, segments are the windows, or are grouped in windows: a pose that is moved stays
moved to the end of its segment."""
LEAST_INFORMED: Final = 0.05
"""Share of the windows' mean information about a parameter; windows with less are left out."""


def courses(problem: Problem, point: Point, causes: set[str]) -> list[Course]:
    """Return every parameter of some of the model's causes in windows of time.

    The estimate is linear about the fitted value, with all other causes fixed. Its interval is the
    larger of the sandwich over the blocks of the window and that of the noise model.
    """
    accepted = problem.accepted(point)
    if accepted is None:
        return []
    windows, out = _windows(problem), []
    for f, mine in zip(point.model.fitted, point.model.slices, strict=True):
        if f.candidate.cause in causes:
            out += _of(problem, point, f, accepted[:, mine], windows)
    return out


def _windows(problem: Problem) -> list[Indices]:
    """Return the samples of about eight windows: of whole segments, or of whole blocks."""
    stack = problem.stack
    many = len(problem.stage.segments) >= FEWEST_SEGMENTS
    unit = stack.segment if many else stack.block
    number = np.maximum(np.bincount(unit), 1)
    middle = np.bincount(unit, stack.t_s) / number
    order = [u for u in np.argsort(middle, kind="stable") if (unit == u).any()]
    width = max(1, round(len(order) / WINDOWS))
    return [
        np.flatnonzero(np.isin(unit, order[k : k + width]))
        for k in range(0, len(order), width)
    ]


def _of(
    problem: Problem, point: Point, f: Fitted, columns: Array, windows: list[Indices]
) -> list[Course]:
    jacobian, times, values, halves = _jacobian(f), [], [], []
    information = np.stack([(columns[rows] ** 2).sum(axis=0) for rows in windows])
    for rows, own in zip(windows, information, strict=True):
        if (own < LEAST_INFORMED * information.mean(axis=0)).any():
            continue
        step, spread, wide = _estimate(problem, point.left[rows], columns[rows], rows)
        times.append(float(problem.stack.t_s[rows].mean()))
        values.append(
            list(f.candidate.terms(tuple(np.asarray(f.theta) + step)).values())
        )
        halves.append(
            wide * np.sqrt(np.einsum("ij,jk,ik->i", jacobian, spread, jacobian))
        )
    out = []
    for k, name in enumerate(f.terms if len(times) > 1 else ()):
        if jacobian[k].any():
            public, t = OF_THE_LOG.get(name, name), np.array(times)
            value, half = (
                np.array([one[k] for one in all_of]) for all_of in (values, halves)
            )
            out.append(
                Course(public, unit_of(public), t, value, value - half, value + half)
            )
    return out


def _jacobian(f: Fitted) -> Array:
    """Return the derivatives of the public parameters by the fitted ones, shape (terms, n)."""
    base = np.array(list(f.terms.values()))
    out = np.zeros((len(base), f.candidate.n))
    for j, step in enumerate(f.candidate.step):
        theta = np.array(f.theta)
        theta[j] += 1e-4 * step
        moved = np.array(list(f.candidate.terms(tuple(theta)).values()))
        out[:, j] = (moved - base) / (1e-4 * step)
    return out


def _estimate(
    problem: Problem, left: Array, columns: Array, rows: Indices
) -> tuple[Array, Array, float]:
    """Return the step of the parameters, its covariance and the factor to 95 %."""
    k = columns.shape[1]
    step = linear.ridge(columns, left)
    _, block = np.unique(problem.stack.block[rows], return_inverse=True)
    rest = left - columns @ step
    own = (columns * rest[:, None]).T
    sums: Array = np.stack([np.bincount(block, weights=one) for one in own], axis=1)
    blocks = max(len(sums), k + 1)
    spread = linear.covariance(columns, sums, blocks, float(np.mean(rest**2)))
    return step, spread, float(stats.t.ppf(0.975, max(blocks - k, 2)))
