"""Wheel speeds that a driver made of an encoder's counts: so many since the sample before.

At short intervals a speed of a few counts is rough: it misses what is less than a count, and errs
as the stamps do. But what one sample misses the next one has, so the angle, their sum, is never off
by more than a count. The speed is the slope of a smooth curve through the angle. How smooth, other
samples of the same angle tell.
"""

from typing import Final

import numpy as np
from scipy.interpolate import make_smoothing_spline
from scipy.ndimage import uniform_filter1d

from hilserver.arrays import Array
from hilserver.diagnosis.thresholds import (
    FEWEST_COUNTS,
    MOST_COUNTS,
    NEGLIGIBLE,
    TELESCOPES,
)
from hilserver.measured.resolution import step_of
from hilserver.measured.thresholds import STEP_EXACT

STIFF: Final = 10.0 ** np.arange(-9.0, 0.1, 0.5)
"""Stiffness of the curve [s3], from one that follows every count to one that bends once a second"""
ENOUGH: Final = 8000  # samples that show it
SMOOTH_OVER: Final = 7  # samples; a robot's speed hardly bends over so few


def is_counted(t_s: Array, speed: Array) -> bool:
    """Return whether speeds are few counts over the time since the sample before."""
    turned = speed[1:] * np.diff(t_s)
    if not turned.any():
        return False

    # the usual turn is some number of counts, and so are then all others
    usual = float(np.median(np.abs(turned[turned != 0.0])))
    for counts in range(1, MOST_COUNTS + 1):
        times = turned * counts / usual
        whole = np.rint(times)
        if float(np.quantile(np.abs(times - whole), 1.0 - NEGLIGIBLE)) < STEP_EXACT:
            break
    else:
        return False
    if len(np.unique(whole)) < FEWEST_COUNTS:
        return False
    if step_of(speed)[0] == 0.0:
        return True  # no speed is a whole number of anything: the intervals differ

    # of speeds that were rounded, the errors of neighbours have nothing to do with each other
    rough = turned - uniform_filter1d(turned, SMOOTH_OVER)
    alike = float(rough[1:] @ rough[:-1]) / max(float(rough @ rough), 1e-300)
    return alike < TELESCOPES


def stiffness(t_s: Array, speed: Array) -> float:
    """Return how stiff a curve through every second sample meets the others best."""
    t_s, speed = t_s[:ENOUGH], speed[:ENOUGH]
    angle = _angle(t_s, speed)
    known, left_out = slice(0, None, 2), slice(1, -1, 2)
    missed = []
    for stiff in STIFF:
        curve = make_smoothing_spline(t_s[known], angle[known], lam=0.5 * stiff)
        missed.append(float(np.square(curve(t_s[left_out]) - angle[left_out]).sum()))
    return float(STIFF[int(np.argmin(missed))])


def smoothed(t_s: Array, speed: Array, stiff: float, at_s: Array) -> Array:
    """Return the speeds at other times; a count belongs to the stamp after it, as it did."""
    curve = make_smoothing_spline(t_s, _angle(t_s, speed), lam=stiff)
    before_s = 0.5 * float(np.median(np.diff(t_s)))
    return np.asarray(curve.derivative()(np.clip(at_s - before_s, t_s[0], t_s[-1])))


def _angle(t_s: Array, speed: Array) -> Array:
    return np.append(0.0, np.cumsum(speed[1:] * np.diff(t_s)))
