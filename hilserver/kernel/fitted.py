"""Outside the range in which a term was fitted, the outputs that it changes are Uncertain.

The ranges are parameters of the plant like others: a patch brings them with its terms.
"""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled import kernel
from hilserver.config.patch import Interval, ModelPatch
from hilserver.image import word
from hilserver.image.status import GOOD, UNCERTAIN
from hilserver.plant import layout as robot
from hilserver.plant.terms import TERMS, main_part

BLOCKS: Final = ("drive", "kinematics", "navigation", "inertial")
N_ROW: Final = 6  # low and high of speed [m/s], turn rate [rad/s], wheel speed [rpm]
N_LIMITS: Final = 1 + len(BLOCKS) * N_ROW  # the first says whether there is a patch
MARGIN: Final = 0.02
"""Share of a range by which it may be left: the plant's ripple is no other condition."""

_NAVIGATION: Final = range(robot.Y_NAV, robot.Y_NAV + 3)
_MOTION: Final = [
    *range(robot.Y_POSE, robot.Y_BATTERY),
    *range(robot.Y_TOF, robot.Y_TOF + 4),
    *_NAVIGATION,
]
_AFFECTED: Final[Mapping[str, list[int]]] = {
    "drive": [*range(robot.Y_POSE), *_MOTION],
    "kinematics": _MOTION,
    "navigation": list(_NAVIGATION),
    "inertial": list(range(robot.Y_IMU, robot.Y_BATTERY)),
}
AFFECTED: Final = np.array(
    [[slot in _AFFECTED[block] for slot in range(robot.N_Y)] for block in BLOCKS]
)
"""Outputs that a term of each block changes."""
N_WHEELS: Final = robot.N_WHEELS
VELOCITY: Final = robot.Y_VELOCITY
N_OUTPUTS: Final = robot.N_Y
FIRST_OUTPUT: Final = robot.N_U


def fitted_limits(patch: ModelPatch | None = None) -> NDArray[np.float64]:
    """Return the range of each block: where all of its terms were fitted.

    Returns
    -------
    ndarray of float64, shape (N_LIMITS,)
        1 with a patch, else 0; then a row per block of `BLOCKS`, infinite where nothing is said.
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


@kernel()
def _is_outside(row: int, outputs: int, values: Any) -> bool:
    v, om = values[outputs + VELOCITY], values[outputs + VELOCITY + 2]
    if not (values[row] <= v <= values[row + 1] and values[row + 2] <= om <= values[row + 3]):
        return True
    for i in range(N_WHEELS):
        if not values[row + 4] <= values[outputs + i] <= values[row + 5]:
            return True
    return False


@kernel()
def flag_unfitted(limits: int, values: Any, words: Any) -> None:
    """Set to Uncertain what a patch was not fitted for in this tick.

    Parameters
    ----------
    limits : int
        Base of the region with the ranges, see `fitted_limits`.
    """
    if values[limits] == 0.0:
        return
    outputs = words[word.FRAME_BASE] + FIRST_OUTPUT
    status = words[word.STATUS_BASE] + FIRST_OUTPUT
    for block in range(AFFECTED.shape[0]):
        if _is_outside(limits + 1 + block * N_ROW, outputs, values):
            for i in range(N_OUTPUTS):
                if AFFECTED[block, i] and words[status + i] == GOOD:
                    words[status + i] = UNCERTAIN
