"""The noise of a log, by its own innovations: that under which its samples were most likely.

Sensors are seldom as noisy as their configuration says, and no model explains a whole motion. What
both leave open decides how far a filter follows the samples and how far the wheels: with too much
noise of the samples the pose goes with wrong wheels; with too little of the motion good samples
count as outliers. Both show in the same innovations, but differently: the noise of a sensor goes
with the sample, that of the motion stays.
"""

import math
from collections.abc import Sequence
from itertools import product
from typing import Final

import numpy as np

from hilserver.observer.figures import WANDER_S
from hilserver.observer.layout import FIGURES, N_FIGURES, FilterFigures
from hilserver.observer.offline import GYRO, Array, MeasuredSeries, misfit
from hilserver.plant.layout import Parameters

OF_NAVIGATION: Final = ("position_sd", "position_ou", "yaw_sd", "yaw_ou")
OF_GYRO: Final = ("gyro_sd", "bias_sd")
OF_MOTION: Final = ("roam", "roam_yaw", "slip_sd", "gain_sd")
DRIFTS: Final = {"slip_sd": "slip_walk", "gain_sd": "gain_walk", "bias_sd": "bias_walk"}
"""What drifts by its own size in `WANDER_S`."""
LEAST, MOST = 1e-4, 10.0
"""A standard deviation, in m, rad, rad/s, m or rad of a metre, or a share: what is smaller does not
show beside the rounding of a covariance, what is larger is no model of a motion."""
STEPS: Final = (16.0, 4.0, 2.0, math.sqrt(2.0))
"""Factors by which a standard deviation is tried larger and smaller; the last is how well it is
known in the end."""
GAINED: Final = 2.0
"""Decrease of the misfit that a change has to bring: what one number brings by chance, twice."""
MOST_SWEEPS: Final = 6  # over all figures, with one factor
MOST_MOMENTS: Final = 20_000  # of a log, from the beginning: a few seconds


def fitted(p: Parameters, c: Array, log: Sequence[MeasuredSeries]) -> Array:
    """Return the constants of the filter with the noise under which a log was most likely.

    Parameters
    ----------
    c : ndarray
        Constants to begin with, see `consider.constants`.
    log : sequence of Series
        All stretches of the log.
    """
    pieces = _beginning(log)
    kinds = [one.samples[:, 0] for one in pieces]
    if not any((kind != GYRO).any() for kind in kinds):
        return c
    names = [*OF_NAVIGATION, *OF_MOTION]
    if any((kind == GYRO).any() for kind in kinds):
        names += OF_GYRO

    def size(trial: Array) -> float:
        found = sum(misfit(p, trial, one) for one in pieces)
        return found if math.isfinite(found) else math.inf

    best, least = c, size(c)
    for factor in STEPS:
        for _ in range(MOST_SWEEPS):
            before = least
            for name, by in product(names, (factor, 1.0 / factor)):
                trial = _with(best, name, by)
                while trial is not None and (now := size(trial)) < least - GAINED:
                    best, least = trial, now
                    trial = _with(best, name, by)
            if least == before:
                break
    return best


def _beginning(log: Sequence[MeasuredSeries]) -> list[MeasuredSeries]:
    pieces, left = [], MOST_MOMENTS
    for one in log:
        wheels = one.wheels[:left]
        if len(wheels) > 1:
            until = int(np.searchsorted(one.samples[:, 1], wheels[-1, 0], "right"))
            pieces.append(MeasuredSeries(wheels, one.samples[:until]))
        left -= len(wheels)
    return pieces


def sd_of(c: Array, name: str) -> float:
    """Return a figure as a standard deviation."""
    value = float(FilterFigures.of(c[:N_FIGURES])[name])
    return math.sqrt(value) if name.startswith("roam") else value


def _with(c: Array, name: str, factor: float) -> Array | None:
    """Return the constants with a figure larger by a factor; None if it would leave its range."""
    sd = max(sd_of(c, name), LEAST) * factor
    if not LEAST <= sd <= MOST:
        return None
    changed = c.copy()
    figures = FilterFigures.of(changed[:N_FIGURES])
    figures[name] = sd * sd if name.startswith("roam") else sd
    if name in DRIFTS:
        figures[DRIFTS[name]] = sd * sd / WANDER_S
    return changed


def inflated(c: Array, by: float) -> Array:
    """Return the constants with all variances larger by a factor."""
    changed = c.copy()
    figures, root = FilterFigures.of(changed[:N_FIGURES]), math.sqrt(by)
    for name in FIGURES.names or ():
        if name.endswith(("_sd", "_ou")) and name != "instant_sd":
            figures[name] *= root
        elif name.endswith(("_walk", "_drift")) or name.startswith("roam"):
            figures[name] *= by
    return changed
