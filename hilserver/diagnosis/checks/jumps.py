"""Places at which the tag is suddenly elsewhere: the recorder stood still, or the room began anew.

A pause that was cut out, with the stamps closed up, and a navigation that finds itself again leave
the same: before and after the place agrees with the wheels, across it nothing does.
"""

from dataclasses import replace
from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import FEWEST_CHANGES, JUMP_LEAST_M, JUMP_SD
from hilserver.measured.channels import NAV_X, NAV_Y, POSITION
from hilserver.measured.data import MeasuredLog
from hilserver.measured.pauses import Pieces, cut
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

SIDE: Final = 10  # samples on either side whose middle counts: outliers are no jump


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Begin a new segment, with a pose of its own, where the tag jumps and stays there."""
    if not log.has(*POSITION):
        return log, []
    edges: list[Pieces] = []
    found: list[tuple[float, float]] = []
    fastest_m_s = 2.0 * robot.wheel_radius_m * robot.max_rpm * RAD_S_PER_RPM
    for index, span in enumerate(log.spans):
        (t_x, x), (t_y, y) = log[NAV_X].of(index), log[NAV_Y].of(index)
        t_s, in_x, in_y = np.intersect1d(t_x, t_y, assume_unique=True, return_indices=True)
        x, y = x[in_x], y[in_y]
        at = jumps(t_s, x, y, fastest_m_s)
        begins = [span.start_s, *t_s[at].tolist()]
        edges.append(list(zip(begins, [*t_s[at - 1].tolist(), span.end_s], strict=True)))
        found += [(float(np.hypot(x[k] - x[k - 1], y[k] - y[k - 1])), float(t_s[k])) for k in at]
    if not found:
        return log, []
    far_m, at_s = max(found)
    times = "once" if len(found) == 1 else f"{len(found)} times"
    note = (
        f"the position jumps {times}, farthest by {far_m:.2g} m at t_s = {at_s:.10g}, and goes on"
        " from there: a pause was cut out, or the navigation began anew; segments end there"
    )
    left = cut(log, edges)
    return replace(left, notices=(*log.notices, note)), []


def jumps(t_s: Array, x: Array, y: Array, fastest_m_s: float) -> Indices:
    """Return the samples from which on the tag is elsewhere.

    Parameters
    ----------
    t_s, x, y : ndarray, shape (n,)
    fastest_m_s : float
        What lies farther apart than this allows no wheels have driven.
    """
    if len(t_s) < FEWEST_CHANGES:
        return np.empty(0, dtype=np.int64)
    steps = np.hypot(np.diff(x), np.diff(y))
    least = JUMP_LEAST_M + JUMP_SD * float(np.median(steps)) + fastest_m_s * np.diff(t_s)
    candidates = np.flatnonzero(steps > least) + 1
    inside = candidates[(candidates >= SIDE) & (candidates <= len(t_s) - SIDE)]

    def middle(part: slice) -> Array:
        return np.array([np.median(x[part]), np.median(y[part])])

    def stays(k: int) -> bool:
        before, after = slice(k - SIDE, k), slice(k, k + SIDE)
        driven_m = fastest_m_s * float(t_s[k + SIDE - 1] - t_s[k - SIDE])
        apart = np.hypot(*(middle(after) - middle(before)))
        return bool(apart > JUMP_LEAST_M + 0.25 * driven_m)

    return np.array([k for k in inside.tolist() if stays(k)], dtype=np.int64)
