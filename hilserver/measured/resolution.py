"""The resolution of a channel: readings that are whole multiples of a step."""

import numpy as np

from hilserver.arrays import Array
from hilserver.measured.thresholds import FEWEST_READINGS, STEP_EXACT, STEP_OFTEN


def step_of(values: Array) -> tuple[float, float]:
    """Return the step between readings and one of them; (0, 0) if there is no step."""
    if len(values) < FEWEST_READINGS:
        return 0.0, 0.0
    different = np.unique(values)
    if len(different) < 3 or len(different) > STEP_OFTEN * len(values):
        return 0.0, 0.0
    gaps = np.diff(different)
    gaps = gaps[gaps > 1e-9 * np.abs(different).max()]
    if not len(gaps):
        return 0.0, 0.0
    step = float(np.median(gaps[gaps < 1.5 * gaps.min()]))
    origin = float(different[0])
    for _ in range(3):  # from neighbours to the whole range: each time a longer lever
        count = np.rint((different - origin) / step)
        step, origin = map(float, np.polyfit(count, different, 1))
        if not step > 0.0:
            return 0.0, 0.0
    since = different - origin
    off = np.abs(since - step * np.rint(since / step))
    is_exact = off.max() < STEP_EXACT * step
    return (step, origin) if is_exact else (0.0, 0.0)
