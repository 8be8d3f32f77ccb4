"""The filter over series of samples, in the order in which they were taken."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled import part
from hilserver.compiled.records import record_at
from hilserver.observer.filter import (
    add_gyro,
    add_position,
    add_yaw,
    close_moment,
    moment,
    open_moment,
)
from hilserver.observer.layout import N_ESTIMATED, N_FILTER, SHOWN, Head, Shown
from hilserver.observer.outputs import show
from hilserver.plant.layout import PARAMETERS, Parameters

Array = NDArray[np.float64]
N_SHOWN: Final = Shown.n_words
GYRO, POSITION, HEADING = range(3)  # kinds of rows of the samples


@dataclass(frozen=True)
class Series:
    """Measurements of one stretch, on one clock."""

    # shape (n, 6); time [s], mean speeds of the left and the right encoders [rad/s], angle
    # of the left wheels [rad], front minus rear wheel on the left and on the right [rad/s]
    wheels: Array
    # shape (m, 4); `GYRO`, `POSITION` or `HEADING`, time at which the quantity had the value [s],
    # and its one or two values; ordered by time
    samples: Array


@dataclass(frozen=True)
class Course:
    """The estimate at each moment."""

    t_s: Array  # shape (n,)
    shown: Array  # shape (n, Shown.n_words); the signals estimate.*
    estimate: Array  # shape (n, N_ESTIMATED)
    covariance: Array  # shape (n, N_ESTIMATED, N_ESTIMATED)
    # shape (n,); of a sample of the navigation that came at this moment, divided by its number of
    # values; else NaN
    innovations: Array
    head: Head  # counters


@part
def _run(
    numbers: Any,
    c: Any,
    f: Any,
    wheels: Any,
    samples: Any,
    x: Any,
    m: Any,
    shown: Any,
    nis: Any,
) -> None:
    p, at = record_at(numbers, 0, PARAMETERS), 0
    for k in range(wheels.shape[0]):
        open_moment(c, f, wheels[k, 0], wheels[k, 1:])
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
        show(c, f, record_at(shown, k * N_SHOWN, SHOWN))
        nis[k] = now.nis if now.has_position + now.has_yaw > 0.0 else math.nan


def run(p: Parameters, c: Array, series: Series) -> Course:
    """Run the filter over a stretch.

    Parameters
    ----------
    c : ndarray
        See `consider.constants`.
    """
    n, f = len(series.wheels), np.zeros(N_FILTER)
    x, m = np.zeros((n, N_ESTIMATED)), np.zeros((n, N_ESTIMATED, N_ESTIMATED))
    shown, nis = np.zeros(n * N_SHOWN), np.zeros(n)
    _run(p.numbers, c, f, series.wheels, series.samples, x, m, shown, nis)
    return Course(series.wheels[:, 0], shown.reshape(n, N_SHOWN), x, m, nis, Head.of(f))
