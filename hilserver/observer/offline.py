"""The filter over series of samples, in the order in which they were taken."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.records import record_at
from hilserver.observer.filter import (
    add_gyro,
    add_position,
    add_yaw,
    close_moment,
    moment,
    open_moment,
)
from hilserver.observer.layout import (
    MOST_DIRECTIONS,
    N_ESTIMATED,
    N_FILTER,
    Head,
)
from hilserver.plant.kernels import part
from hilserver.plant.layout import PARAMETERS, Parameters

Array = NDArray[np.float64]
GYRO, POSITION, HEADING = range(3)
"""What a row of the samples is."""


@dataclass(frozen=True)
class Series:
    """What was measured of one stretch, on one clock.

    Attributes
    ----------
    wheels : ndarray, shape (n, 4)
        Time [s], mean speeds of the left and right wheels [rad/s], angle of the left ones [rad].
    samples : ndarray, shape (m, 4)
        `GYRO`, `POSITION` or `HEADING`, time at which the quantity had the value [s], and its one
        or two values; in the order of time.
    """

    wheels: Array
    samples: Array


@dataclass(frozen=True)
class Course:
    """What is known at each moment; covariances are those of the states and of the directions.

    Attributes
    ----------
    t_s, nis : ndarray, shape (n,)
        Time; innovation of the last sample by its number of values.
    estimate : ndarray, shape (n, N_ESTIMATED)
    covariance : ndarray, shape (n, N_ESTIMATED, N_ESTIMATED)
    fixed : ndarray of bool, shape (n,)
        Whether a position has been taken in.
    last_fix : ndarray, shape (n,)
        Time of the last sample of the navigation that was taken in [s].
    head : Head
        What was counted.
    """

    t_s: Array
    estimate: Array
    covariance: Array
    cross: Array
    nis: Array
    fixed: NDArray[np.bool_]
    last_fix: Array
    head: Head


N_SHOWN: Final = 4


@part
def _run(
    numbers: Any, c: Any, f: Any, wheels: Any, samples: Any, x: Any, m: Any, cross: Any, shown: Any
) -> None:
    p, at = record_at(numbers, 0, PARAMETERS), 0
    for k in range(wheels.shape[0]):
        open_moment(c, f, wheels[k, 0], wheels[k, 1], wheels[k, 2], wheels[k, 3])
        while at < samples.shape[0] and samples[at, 1] <= wheels[k, 0]:
            kind, time = samples[at, 0], samples[at, 1]
            if kind == GYRO:
                add_gyro(f, time, samples[at, 2])
            elif kind == POSITION:
                add_position(f, time, samples[at, 2], samples[at, 3])
            else:
                add_yaw(f, time, samples[at, 2])
            at += 1
        close_moment(p, c, f)
        now = moment(f, 0)
        for i in range(N_ESTIMATED):
            x[k, i] = now.estimate[i]
            for j in range(N_ESTIMATED):
                m[k, i, j] = now.covariance[i, j]
            for j in range(cross.shape[2]):
                cross[k, i, j] = now.cross[i, j]
        shown[k, 0], shown[k, 1] = now.nis, now.fixed_position
        shown[k, 2] = now.last_fix


def run(p: Parameters, c: Array, series: Series) -> Course:
    """Run the filter over a stretch.

    Parameters
    ----------
    c : ndarray
        See `consider.constants`.
    """
    n, f = len(series.wheels), np.zeros(N_FILTER)
    x, m = np.zeros((n, N_ESTIMATED)), np.zeros((n, N_ESTIMATED, N_ESTIMATED))
    cross, shown = np.zeros((n, N_ESTIMATED, MOST_DIRECTIONS)), np.zeros((n, N_SHOWN))
    _run(p.numbers, c, f, series.wheels, series.samples, x, m, cross, shown)
    t_s = series.wheels[:, 0]
    head = Head.of(f)
    return Course(t_s, x, m, cross, shown[:, 0], shown[:, 1] > 0.0, shown[:, 2], head)
