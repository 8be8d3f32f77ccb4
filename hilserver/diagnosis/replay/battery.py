"""The battery's voltage at every tick, from a noisy sensor."""

from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.measured.channels import VOLTAGE
from hilserver.measured.clock import Segments
from hilserver.measured.data import MeasuredLog
from hilserver.plant.units import NOMINAL_V

SMOOTHING_S: Final = 2.0
LATELY_S: Final = 0.02
"""A voltage is used if the load did not change for this long: the sensor may lag."""
STEADY_PCT: Final = 5.0  # largest change of the sum of the duties


def voltage(log: MeasuredLog, segments: Segments, load: Array) -> Array:
    """Return the battery voltage at every tick, without the noise of its sensor.

    Noise on the voltage would drive the simulated loop. So the voltage is split into what follows
    the load at once (the simulated sum of the duties) and the rest, which is smoothed. The battery
    of a simulation has no noise, and keeps its voltage between two runs of its slice.
    """
    if log.on_ticks:
        return _held(log, segments)
    volts = np.full(segments.ticks, NOMINAL_V)
    for i, span in enumerate(segments.span):
        t, v = log[VOLTAGE].of(int(span))
        if len(t) < 2:
            continue
        part = slice(int(segments.first[i]), int(segments.first[i + 1]))
        ticks = segments.times(i)
        at_samples = np.interp(t, ticks, load[part])
        lately = np.interp(t - LATELY_S, ticks, load[part])
        calm = np.abs(at_samples - lately) < STEADY_PCT
        if calm.sum() < 10:
            continue
        t, v, at_samples = t[calm], v[calm], at_samples[calm]
        width = max(1, round(SMOOTHING_S / float(np.median(np.diff(t)))))
        fast_v, fast_load = v - _mean(v, width), at_samples - _mean(at_samples, width)
        drop = float(fast_load @ fast_v) / max(float(fast_load @ fast_load), 1e-9)
        slow = _mean(v - drop * at_samples, width)
        volts[part] = np.interp(ticks, t, slow) + drop * load[part]
    return volts


def _held(log: MeasuredLog, segments: Segments) -> Array:
    """Return the last voltage before every tick: the battery runs after the drive in each tick."""
    volts = np.full(segments.ticks, NOMINAL_V)
    for i, span in enumerate(segments.span):
        t, v = log[VOLTAGE].of(int(span))
        if len(t):
            last = np.searchsorted(t, segments.times(i) - 0.5 * segments.period_s) - 1
            volts[segments.first[i] : segments.first[i + 1]] = v[np.maximum(last, 0)]
    return volts


def _mean(values: Array, width: int) -> Array:
    """Return the moving mean over `width` samples, shorter at the ends."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    index = np.arange(len(values))
    low = np.maximum(index - width // 2, 0)
    high = np.minimum(index + width // 2 + 1, len(values))
    return np.asarray((total[high] - total[low]) / (high - low))
