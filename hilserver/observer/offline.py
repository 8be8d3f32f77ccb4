"""The filter over series of samples, in the order in which they were taken."""

from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled import inlined, part
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
class MeasuredSeries:
    """Measurements of one stretch, on one clock."""

    # shape (n, 6); time [s], mean speeds of the left and the right encoders [rad/s], angle
    # of the left wheels [rad], front minus rear wheel on the left and on the right [rad/s]
    wheels: Array
    # shape (m, 4); `GYRO`, `POSITION` or `HEADING`, time at which the quantity had the value [s],
    # and its one or two values; ordered by time
    samples: Array


@dataclass(frozen=True)
class EstimatedCourse:
    """The estimate at each moment."""

    t_s: Array  # shape (n,)
    shown: Array  # shape (n, Shown.n_words); the signals estimate.*
    estimate: Array  # shape (n, N_ESTIMATED)
    covariance: Array  # shape (n, N_ESTIMATED, N_ESTIMATED)
    # shape (n, 2); of position and heading that came at a moment, divided by the number of values;
    # NaN: none came
    innovations: Array
    carried: Array  # shape (n,); flag: at this moment the robot was found carried
    head: Head  # counters


@inlined
def _moment(p: Parameters, c: Any, f: Any, row: Any, samples: Any, at: int) -> int:
    """Compute the moment of a row of the wheels; return the first sample that is newer."""
    open_moment(c, f, row[0], row[1:])
    while at < samples.shape[0] and samples[at, 1] <= row[0]:
        kind, time = samples[at, 0], samples[at, 1]
        if kind == GYRO:
            add_gyro(f, time, samples[at, 2])
        elif kind == POSITION:
            add_position(f, time, samples[at, 2], samples[at, 3])
        else:
            add_yaw(f, time, samples[at, 2])
        at += 1
    close_moment(p, c, f)
    return at


@part
def _misfit(numbers: Any, c: Any, f: Any, wheels: Any, samples: Any) -> float:
    p, at = record_at(numbers, 0, PARAMETERS), 0
    for k in range(wheels.shape[0]):
        at = _moment(p, c, f, wheels[k], samples, at)
    return float(moment(f, 0).misfit)


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
    carried: Any,
) -> None:
    p, at = record_at(numbers, 0, PARAMETERS), 0
    for k in range(wheels.shape[0]):
        at = _moment(p, c, f, wheels[k], samples, at)
        now = moment(f, 0)
        for i in range(N_ESTIMATED):
            x[k, i] = now.estimate[i]
            for j in range(N_ESTIMATED):
                m[k, i, j] = now.covariance[i, j]
        show(c, f, record_at(shown, k * N_SHOWN, SHOWN))
        nis[k, 0], nis[k, 1] = now.surprise[0], now.surprise[1]
        carried[k] = now.carried


def misfit(p: Parameters, c: Array, series: MeasuredSeries) -> float:
    """Return minus twice the log-likelihood of the samples, each predicted from those before."""
    f = np.zeros(N_FILTER)
    return float(_misfit(p.numbers, c, f, series.wheels, series.samples))


def run(p: Parameters, c: Array, series: MeasuredSeries) -> EstimatedCourse:
    """Run the filter over a stretch.

    Parameters
    ----------
    c : ndarray
        See `consider.constants`.
    """
    n, f = len(series.wheels), np.zeros(N_FILTER)
    x, m = np.zeros((n, N_ESTIMATED)), np.zeros((n, N_ESTIMATED, N_ESTIMATED))
    shown, nis, carried = np.zeros(n * N_SHOWN), np.zeros((n, 2)), np.zeros(n)
    _run(p.numbers, c, f, series.wheels, series.samples, x, m, shown, nis, carried)
    head, signals = Head.of(f), shown.reshape(n, N_SHOWN)
    return EstimatedCourse(series.wheels[:, 0], signals, x, m, nis, carried, head)
