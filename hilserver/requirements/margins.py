"""The margin of a requirement: its robustness in the sense of signal temporal logic.

A sample's margin is its distance to the bound, positive where the bound is kept. A requirement has
to hold from a start on, for a while; its margin is that of the worst sample of the best start
(Donzé and Maler, Robust Satisfaction of Temporal Logic over Real-Valued Signals, 2010). It is met
when the margin is not negative.
"""

import math

import numpy as np

from hilserver.arrays import Array
from hilserver.requirements.model import Requirement

_ROUNDING = 1e-9  # of a tick: a time that is a tick but for rounding is that tick


def margin(requirement: Requirement, values: Array, period_s: float) -> float:
    """Return how far the samples of a drive are from failing, in the signal's unit.

    Parameters
    ----------
    values : ndarray of float64, shape (n,)
        One sample a tick, the first at 0 s.
    period_s : float
        Of a tick [s].

    Returns
    -------
    float
        Negative: not met; -inf where a sample is not a number, or the drive ends too early.
    """
    samples = sample_margins(requirement, values)
    first = math.ceil(requirement.after_s / period_s - _ROUNDING)
    last = first
    if requirement.within_s is not None:
        last = math.floor(requirement.within_s / period_s + _ROUNDING)
    last = min(last, len(samples) - 1)
    if first > last:
        return -math.inf
    held = _held(requirement, samples[first:], period_s)
    return float(held[: last - first + 1].max(initial=-math.inf))


def sample_margins(requirement: Requirement, values: Array) -> Array:
    """Return the distance of each sample to the bound, shape (n,)."""
    samples = np.full(len(values), math.inf)
    if requirement.below is not None:
        samples = np.minimum(samples, requirement.below - values)
    if requirement.above is not None:
        samples = np.minimum(samples, values - requirement.above)
    if requirement.equals is not None:
        samples = requirement.tolerance - np.abs(values - requirement.equals)
    return np.where(np.isnan(samples), -math.inf, samples)


def _held(requirement: Requirement, samples: Array, period_s: float) -> Array:
    """Return the worst margin from each start on for as long as it has to hold.

    Starts after which the drive is too short are left out.
    """
    if requirement.for_s is None:
        if requirement.within_s is not None and not requirement.always:
            return samples
        to_the_end: Array = np.minimum.accumulate(samples[::-1])[::-1]
        return to_the_end
    n = math.floor(requirement.for_s / period_s + _ROUNDING) + 1
    if n > len(samples):
        return samples[:0]
    if requirement.within_s is None:
        return np.array([samples[:n].min()])
    return _sliding_minimum(samples, n)


def _sliding_minimum(samples: Array, n: int) -> Array:
    """Return the minimum of every `n` samples that follow each other, shape (len - n + 1,)."""
    from scipy.ndimage import minimum_filter1d  # noqa: PLC0415 - few requirements need it

    filtered: Array = minimum_filter1d(samples, n, origin=-(n // 2), mode="nearest")
    return filtered[: len(samples) - n + 1]
