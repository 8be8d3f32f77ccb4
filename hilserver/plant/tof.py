"""Four range finders at the corners, looking along x into a hall made of line segments.

A sensor shows the nearest point of the hall inside its cone. That point is found exactly: each
segment is clipped to the cone and its nearest point taken, so no thin wall is missed between rays.
"""

import math
from typing import Any, Final

from hilserver.compiled import inlined, part
from hilserver.plant.layout import Inputs, Outputs, Parameters, State, Status
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD, UNCERTAIN

NEAREST_M: Final = 0.01
FARTHEST_M: Final = 5.0


@inlined
def _nearest_in_cone(
    ax: float, ay: float, bx: float, by: float, sin: float, cos: float
) -> float:
    """Return the distance from the origin to the part of a segment inside the cone along +x.

    The cone is where ``x sin - y cos >= 0`` and ``x sin + y cos >= 0``; inf if no part is inside.
    """
    first, last = 0.0, 1.0
    for side in (-1.0, 1.0):
        at_a = ax * sin + side * ay * cos
        at_b = bx * sin + side * by * cos
        if at_a < 0.0 and at_b < 0.0:
            return math.inf
        if at_a < 0.0:
            first = max(first, at_a / (at_a - at_b))
        elif at_b < 0.0:
            last = min(last, at_a / (at_a - at_b))
    if first > last:
        return math.inf
    dx, dy = bx - ax, by - ay
    square = dx * dx + dy * dy
    nearest = -(ax * dx + ay * dy) / square if square > 0.0 else 0.0
    share = min(max(nearest, first), last)
    return math.hypot(ax + share * dx, ay + share * dy)


@inlined
def _range(
    p: Parameters, hall: Any, px: float, py: float, cos: float, sin: float
) -> float:
    """Return the distance [m] seen from a point along the unit vector (cos, sin)."""
    found = math.inf
    for k in range(0, hall.shape[0] - 3, 4):
        ax, ay = hall[k] - px, hall[k + 1] - py
        bx, by = hall[k + 2] - px, hall[k + 3] - py
        distance = _nearest_in_cone(
            ax * cos + ay * sin,
            ay * cos - ax * sin,
            bx * cos + by * sin,
            by * cos - bx * sin,
            p.tof_sin,
            p.tof_cos,
        )
        found = min(found, distance)
    return found


@part
def seen_by(p: Parameters, hall: Any, k: int, x: float, y: float, yaw: float) -> float:
    """Return what range finder `k` (fl, fr, rl, rr) sees from a pose [m]; inf if nothing."""
    cos, sin = math.cos(yaw), math.sin(yaw)
    along = p.tof_x if k < 2 else -p.tof_x
    aside = p.tof_y if k % 2 == 0 else -p.tof_y
    px = x + along * cos - aside * sin
    py = y + along * sin + aside * cos
    ahead = 1.0 if k < 2 else -1.0
    return float(_range(p, hall, px, py, ahead * cos, ahead * sin))


@part
def tof_step(
    p: Parameters,
    x: State,  # noqa: ARG001
    u: Inputs,  # noqa: ARG001
    y: Outputs,
    q: Status,
    hall: Any,
) -> None:
    """Publish the four ranges in the order fl, fr, rl, rr.

    Parameters
    ----------
    p, x, u, y, q
        As for `robot_step`, which must have run in this tick.
    hall : ndarray of float64, shape (4 n,)
        Walls, each with x1, y1, x2, y2 [m] in the world frame.
    """
    if p.tof_enabled == 0.0:
        for k in range(4):
            q.tof[k] = BAD_OUT_OF_SERVICE
        return
    show_ranges(p, hall, y.pose[0], y.pose[1], y.pose[2], y, q)


@part
def show_ranges(
    p: Parameters, hall: Any, x: float, y_m: float, yaw: float, y: Outputs, q: Status
) -> None:
    """Publish the four ranges seen from a pose."""
    for k in range(4):
        distance = seen_by(p, hall, k, x, y_m, yaw)
        y.tof[k] = min(max(distance, NEAREST_M), FARTHEST_M)
        q.tof[k] = GOOD if distance <= FARTHEST_M else UNCERTAIN
