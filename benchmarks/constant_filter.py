"""A Kalman filter of the pose with constant covariances, as one writes it in an hour.

The wheels move the pose, by the configured kinematics; position and heading correct it.
"""

import math
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.observer.offline import HEADING, POSITION, MeasuredSeries
from hilserver.plant.layout import Parameters

PROCESS: Final = np.array([0.02, 0.02, 0.02]) ** 2
"""Variance per second of x, y [m2] and yaw [rad2]."""
POSE: Final = np.array([0.005, 0.005, 0.005]) ** 2
"""Of x, y [m2] and yaw [rad2] as the navigation shows them: motion capture."""


def constant_filter(p: Parameters, series: MeasuredSeries) -> Array:
    """Return x, y [m] and yaw [rad] at each moment, shape (n, 3)."""
    x, m = np.zeros(3), np.eye(3) * 1e3
    wheels, samples = series.wheels, series.samples
    path, at = np.zeros((len(wheels), 3)), 0
    for k, (time, left, right, _, *apart) in enumerate(wheels.tolist()):
        dt = time - wheels[k - 1, 0] if k else 0.0
        x, m = _moved(p, x, m, dt, (left, right, *apart))

        while at < len(samples) and samples[at, 1] <= time:
            kind, _, *values = samples[at].tolist()
            at += 1
            if kind == POSITION:
                for place, value in enumerate(values):
                    x, m = _corrected(x, m, place, value - x[place])
            elif kind == HEADING:
                off = math.remainder(values[0] - x[2], 2.0 * math.pi)
                x, m = _corrected(x, m, 2, off)
        path[k] = x
    return path


def _moved(
    p: Parameters, x: Array, m: Array, dt: float, wheels: tuple[float, ...]
) -> tuple[Array, Array]:
    left, right, apart_left, apart_right = wheels
    ahead = 0.5 * (p.radius_left * left - p.radius_right * right)
    aside = p.radius_left * apart_left + p.radius_right * apart_right
    aside *= -0.25 * p.mecanum
    turn = p.yaw_gain * (p.radius_left * left + p.radius_right * right)

    cos, sin = math.cos(x[2]), math.sin(x[2])
    way = np.array([ahead * cos - aside * sin, ahead * sin + aside * cos, turn]) * dt
    f = np.eye(3)
    f[0, 2], f[1, 2] = -way[1], way[0]
    return x + way, f @ m @ f.T + np.diag(PROCESS) * dt


def _corrected(x: Array, m: Array, place: int, off: float) -> tuple[Array, Array]:
    gain = m[:, place] / (m[place, place] + POSE[place])
    return x + gain * off, m - np.outer(gain, m[place])
