"""Shows the newest moment of the filter as the signals estimate.*."""

import math
from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.observer.filter import moment
from hilserver.observer.layout import (
    BIAS,
    CONVERGING,
    DEAD_RECKONING,
    FIGURES,
    HEAD,
    HEADING,
    NO_FIX,
    OM,
    PLACE,
    SILENT_S,
    TRACKING,
    YAW,
    FilterFigures,
    Moment,
    Shown,
    V,
    X,
    Y,
)
from hilserver.plant.pose import wrap

BETTER = 0.9
"""Share of a sample's variance below which the pose counts as known better than by the sample."""


@inlined
def _state(c: FilterFigures, m: Moment) -> int:
    """Return whether a pose is known, and from what.

    The state is CONVERGING until the pose is known better than by one sample of the navigation.
    """
    if m.fixed[PLACE] == 0.0 or m.fixed[HEADING] == 0.0:
        return NO_FIX
    if m.time - m.last_fix > SILENT_S:
        return DEAD_RECKONING
    place = max(m.covariance[X, X], m.covariance[Y, Y])
    is_far = place > BETTER * (
        c.position_sd * c.position_sd + c.position_ou * c.position_ou
    )
    is_turned = m.covariance[YAW, YAW] > BETTER * (
        c.yaw_sd * c.yaw_sd + c.yaw_ou * c.yaw_ou
    )
    return CONVERGING if is_far or is_turned else TRACKING


@part
def show(c: Any, f: Any, out: Shown) -> None:
    """Write the present estimate."""
    m, head = moment(f, 0), record_at(f, 0, HEAD)
    x, p = m.estimate, m.covariance
    out.x, out.y, out.yaw = x[X], x[Y], wrap(x[YAW])
    out.linear, out.angular, out.gyro_bias = x[V], x[OM], x[BIAS]
    for i in range(BIAS + 1):
        out.deviations[i] = math.sqrt(max(p[i, i], 0.0))
    out.x_y, out.x_yaw, out.y_yaw = p[X, Y], p[X, YAW], p[Y, YAW]
    out.nis = m.nis if math.isfinite(m.nis) else 1.0
    out.state = _state(record_at(c, 0, FIGURES), m)
    out.rejected = head.rejected
