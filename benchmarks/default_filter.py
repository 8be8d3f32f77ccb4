"""A Kalman filter as on robots without a diagnosis: five states, default covariances.

Like `robot_localization`: the pose moves with the speeds in the state, wheels and gyro measure
these, and process noise is the default in its documentation. Kinematics are the configured ones.
"""

import math
from typing import Any, Final

import numpy as np

from hilserver.arrays import Array
from hilserver.compiled import kernel
from hilserver.observer.offline import GYRO, POSITION, MeasuredSeries
from hilserver.plant.layout import Parameters

PROCESS: Final = np.array([0.05, 0.05, 0.06, 0.025, 0.02])
"""Variance per second of x, y, yaw, speed and turn rate (ekf_node's process_noise_covariance)."""
POSE: Final = np.array([0.05**2, 0.05**2, 0.015**2])
"""Of the navigation, from its data sheet."""
TWIST: Final = np.array([1e-3, 1e-3])
"""Of the wheels' odometry, as drivers publish it by default."""
RATE: Final = 0.006**2


@kernel()
def _take(x: Any, m: Any, place: int, innovation: float, variance: float) -> None:
    total, column = m[place, place] + variance, m[:, place].copy()
    for i in range(5):
        x[i] += column[i] / total * innovation
        for j in range(5):
            m[i, j] -= column[i] * column[j] / total


@kernel()
def _run(
    wheels: Any, samples: Any, r: Any, process: Any, pose: Any, twist: Any, rate: float
) -> Any:
    out, x, m, at = np.zeros((wheels.shape[0], 3)), np.zeros(5), np.eye(5) * 1e3, 0
    for k in range(wheels.shape[0]):
        dt = wheels[k, 0] - wheels[k - 1, 0] if k else 0.0
        cos, sin = math.cos(x[2]), math.sin(x[2])
        f = np.eye(5)
        f[0, 2], f[0, 3], f[1, 2], f[1, 3] = (
            -x[3] * sin * dt,
            cos * dt,
            x[3] * cos * dt,
            sin * dt,
        )
        f[2, 4] = dt
        x[0] += x[3] * cos * dt
        x[1] += x[3] * sin * dt
        x[2] += x[4] * dt
        m = f @ m @ f.T
        for i in range(5):
            m[i, i] += process[i] * dt
        left, right = r[0] * wheels[k, 1], r[1] * wheels[k, 2]
        _take(x, m, 3, 0.5 * (left - right) - x[3], twist[0])
        _take(x, m, 4, r[2] * (left + right) - x[4], twist[1])
        while at < samples.shape[0] and samples[at, 1] <= wheels[k, 0]:
            if samples[at, 0] == 0:
                _take(x, m, 4, samples[at, 2] - x[4], rate)
            elif samples[at, 0] == 1:
                _take(x, m, 0, samples[at, 2] - x[0], pose[0])
                _take(x, m, 1, samples[at, 3] - x[1], pose[1])
            else:
                turn = samples[at, 2] - x[2]
                turn -= 2.0 * math.pi * math.floor(turn / (2.0 * math.pi) + 0.5)
                _take(x, m, 2, turn, pose[2])
            at += 1
        out[k] = x[:3]
    return out


def default_filter(p: Parameters, series: MeasuredSeries, pose: Array = POSE) -> Array:
    """Return x, y [m] and yaw [rad] at each moment, shape (n, 3).

    Parameters
    ----------
    p : Parameters
        Of the configured robot, without a patch.
    """
    assert (GYRO, POSITION) == (0, 1)
    r = np.array([p.radius_left, p.radius_right, p.yaw_gain])
    path: Array = _run(series.wheels, series.samples, r, PROCESS, pose, TWIST, RATE)
    return path
