"""The smoother: runs backwards over the filter's result, so each moment also uses later samples.

The smoother of Rauch, Tung and Striebel. The part of the covariance that is due to uncertain
parameters is kept as the filter has it.
"""

from typing import Any

import numpy as np

from hilserver.compiled import part
from hilserver.compiled.records import record_at
from hilserver.observer.filter import read
from hilserver.observer.layout import (
    BIAS,
    FIGURES,
    GAIN,
    N_ESTIMATED,
    N_FIGURES,
    OM,
    OU_X,
    OU_Y,
    OU_YAW,
    SLIP,
    YAW,
    FilterFigures,
    Head,
    Moment,
    V,
    X,
    Y,
)
from hilserver.observer.motion import bend, predict, transition
from hilserver.observer.offline import Array, EstimatedCourse, MeasuredSeries
from hilserver.plant.layout import PARAMETERS, Parameters

_REGULAR = 1e-14


@part
def _predicted(
    numbers: Any,
    c: Any,
    h: Head,
    wheels: Any,
    k: int,
    x: Any,
    m: Any,
    a: Moment,
    b: Moment,
) -> Any:
    """Predict moment k + 1 into `b` from the estimate at k; return the entries of F."""
    p = record_at(numbers, 0, PARAMETERS)
    read(a, wheels[k, 0], wheels[k, 1:])
    read(b, wheels[k + 1, 0], wheels[k + 1, 1:])
    if k > 0:
        bend(wheels[k - 1, 0], wheels[k - 1, 1], wheels[k - 1, 2], a, b)
    for i in range(N_ESTIMATED):
        a.estimate[i] = x[k, i]
        for j in range(N_ESTIMATED):
            a.covariance[i, j] = m[k, i, j]
    predict(p, c, h, a, b)
    return transition(p, record_at(c, 0, FIGURES), a, b)


def _dense(f: tuple[float, ...]) -> Array:
    """Return F as a matrix, from the entries of `motion.transition`."""
    m, by = np.eye(N_ESTIMATED), [YAW, V, OM, SLIP, GAIN]
    m[X, by], m[Y, by] = f[0:5], f[5:10]
    m[YAW, [OM, GAIN]] = f[10:12]
    m[V, [V, SLIP]] = f[12:14]
    m[OM, [OM, GAIN]] = f[12], f[14]
    m[OU_X, OU_X] = m[OU_Y, OU_Y] = f[15]
    m[OU_YAW, OU_YAW], m[BIAS, BIAS] = f[16], 1.0
    return m


def smooth(
    p: Parameters,
    c: Array,
    series: MeasuredSeries,
    course: EstimatedCourse,
    first: int = 0,
) -> tuple[Array, Array]:
    """Return estimates and covariances that use all samples, from moment `first` on.

    Parameters
    ----------
    first : int
        First moment at which the pose is known; earlier ones stay as the filter has them.

    Returns
    -------
    estimate : ndarray, shape (n, N_ESTIMATED)
    covariance : ndarray, shape (n, N_ESTIMATED, N_ESTIMATED)
    """
    x, m = course.estimate.copy(), course.covariance.copy()
    a, b, h, sure = Moment.zeros(), Moment.zeros(), Head.zeros(), c[:N_FIGURES].copy()
    FilterFigures.of(sure).directions = FilterFigures.of(sure).considered = 0.0
    for k in range(len(x) - 2, first - 1, -1):
        if course.carried[k + 1]:
            continue  # what came after says nothing about where the robot was before
        f = _dense(
            _predicted(
                p.numbers,
                sure,
                h,
                series.wheels,
                k,
                course.estimate,
                course.covariance,
                a,
                b,
            )
        )
        ahead = b.covariance.copy()
        scale = np.sqrt(np.diag(ahead)) + _REGULAR
        whole = ahead / np.outer(scale, scale) + _REGULAR * np.eye(N_ESTIMATED)
        gain = (
            np.linalg.solve(whole, (f @ course.covariance[k]) / scale[:, None])
        ).T / scale
        x[k] += gain @ (x[k + 1] - b.estimate)
        m[k] += gain @ (m[k + 1] - ahead) @ gain.T
    return x, m
