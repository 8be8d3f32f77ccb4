"""Marks the outputs that a term changes Uncertain outside the range in which it was fitted.

The ranges are parameters of the plant like any other; a patch brings them with its terms.
"""

import math
from collections.abc import Mapping, Sequence
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.config.patch import Interval, ModelPatch
from hilserver.image import word
from hilserver.plant.layout import N_WHEELS, OUTPUTS, Inputs, Outputs
from hilserver.plant.terms import TERMS, main_part
from hilserver.status import GOOD, UNCERTAIN

BLOCKS: Final = ("drive", "kinematics", "navigation", "inertial")
N_ROW: Final = 6  # low and high of speed [m/s], turn rate [rad/s], wheel speed [rpm]
N_LIMITS: Final = 1 + len(BLOCKS) * N_ROW  # the first is 1 if there is a patch
MARGIN: Final = 0.02
"""Share of a range by which it may be exceeded, so that ripple does not count as leaving it."""

_INERTIAL: Final = ("gyro", "heading", "accel_x", "accel_y")
_MOTION: Final = ("pose", "linear", "lateral", "angular", *_INERTIAL, "tof", "nav")
_AFFECTED: Final[Mapping[str, Sequence[str]]] = {
    "drive": ("speed", "duty", "angle", *_MOTION),
    "kinematics": _MOTION,
    "navigation": ("nav",),
    "inertial": _INERTIAL,
}


def _affected() -> NDArray[np.bool_]:
    table = np.zeros((len(BLOCKS), Outputs.n_words), dtype=np.bool_)
    for row, block in zip(table, BLOCKS, strict=True):
        for name in _AFFECTED[block]:
            row[Outputs.where(name)] = True
    return table


AFFECTED: Final = _affected()  # outputs that a term of each block changes
FIRST_OUTPUT: Final = Inputs.n_words


def fitted_limits(patch: ModelPatch | None = None) -> NDArray[np.float64]:
    """Return the range of each block in which all of its terms were fitted.

    Returns
    -------
    ndarray of float64, shape (N_LIMITS,)
        1 with a patch, else 0; then a row per block of `BLOCKS`, infinite where no range is given.
    """
    limits = np.tile([-math.inf, math.inf], (len(BLOCKS), N_ROW // 2))
    for name, term in {} if patch is None else patch.terms.items():
        row = limits[BLOCKS.index(TERMS[main_part(name)].block)]
        where = term.fitted_in
        ranges = (where.speed_m_s, where.turn_rate_rad_s, where.wheel_speed_rpm)
        for at, interval in enumerate(ranges):
            low, high = _widened(interval)
            row[2 * at] = max(row[2 * at], low)
            row[2 * at + 1] = min(row[2 * at + 1], high)
    return np.concatenate([[float(patch is not None)], limits.ravel()])


def _widened(interval: Interval | None) -> Interval:
    if interval is None:
        return -math.inf, math.inf
    low, high = interval
    margin = MARGIN * (high - low)
    return low - margin, high + margin


@inlined
def _is_outside(row: int, outputs: int, values: Any) -> bool:
    y = record_at(values, outputs, OUTPUTS)
    if not values[row] <= y.linear <= values[row + 1]:
        return True
    if not values[row + 2] <= y.angular <= values[row + 3]:
        return True
    outside = False
    for i in range(N_WHEELS):
        outside |= not values[row + 4] <= y.speed[i] <= values[row + 5]
    return outside


@part
def flag_unfitted(limits: int, values: Any, words: Any) -> None:
    """Set the outputs to Uncertain for which the patch was not fitted at this tick's motion.

    `limits`: base of the region with the ranges, see `fitted_limits`.
    """
    if values[limits] == 0.0:
        return
    outputs = words[word.FRAME_BASE] + FIRST_OUTPUT
    status = words[word.STATUS_BASE] + FIRST_OUTPUT
    for block in range(AFFECTED.shape[0]):
        if _is_outside(limits + 1 + block * N_ROW, outputs, values):
            for i in range(AFFECTED.shape[1]):
                if AFFECTED[block, i] and words[status + i] == GOOD:
                    words[status + i] = UNCERTAIN
