"""The observer as a time slice: takes new readings and shows the present estimate."""

import math
from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.observer.filter import (
    add_gyro,
    add_position,
    add_yaw,
    close_moment,
    moment,
    open_moment,
)
from hilserver.observer.layout import (
    FIGURES,
    HEAD,
    N_ESTIMATED,
    NO_FIX,
    OLDEST_S,
    Shown,
)
from hilserver.observer.outputs import show
from hilserver.plant.layout import Parameters
from hilserver.plant.units import RAD_S_PER_RPM
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD, UNCERTAIN


@part
def begin_run(c: Any, f: Any, time: float, speed: Any, angle_left: float) -> None:
    """Begin the moment of this run with four wheel speeds [rpm]."""
    left = 0.5 * RAD_S_PER_RPM * (speed[0] + speed[1])
    right = 0.5 * RAD_S_PER_RPM * (speed[2] + speed[3])
    apart_left = RAD_S_PER_RPM * (speed[0] - speed[1])
    apart_right = RAD_S_PER_RPM * (speed[2] - speed[3])
    open_moment(c, f, time, (left, right, angle_left, apart_left, apart_right))


@inlined
def new_gyro(
    p: Parameters, c: Any, f: Any, count: float, time: float, rate: float
) -> None:
    """Add the gyro's reading [rad/s], which came at `time` [s], if its counter has changed."""
    h = record_at(f, 0, HEAD)
    if count != h.seen_gyro:
        h.seen_gyro = count
        add_gyro(f, time - p.imu_delay * record_at(c, 0, FIGURES).imu_period, rate)


@part
def new_pose(
    p: Parameters,
    c: Any,
    f: Any,
    count: float,
    time: float,
    x: float,
    y: float,
    yaw: float,
) -> None:
    """Add the navigation's sample, which came at `time` [s], if its counter has changed."""
    h, period = record_at(f, 0, HEAD), record_at(c, 0, FIGURES).nav_period
    if count != h.seen_position:
        h.seen_position = count
        add_yaw(f, time - p.nav_yaw_delay * period, yaw)
        add_position(f, time - p.nav_delay * period, x, y)


@inlined
def when(stamp: float, now: float) -> float:
    """Return the time of a sample [s]: its stamp, or now if the stamp is implausible."""
    return stamp if now - OLDEST_S <= stamp <= now else now


@inlined
def _is_sound(f: Any) -> bool:
    m = moment(f, 0)
    for i in range(N_ESTIMATED):
        if not math.isfinite(m.estimate[i]) or not m.covariance[i, i] > -1e-6:
            return False
    return True


@part
def end_run(
    p: Parameters, c: Any, f: Any, is_read: bool, out: Shown, codes: Any
) -> None:
    """Process the new readings and show the estimate, which is Uncertain without a fix.

    Parameters
    ----------
    is_read : bool
        Whether the wheels' speeds are good readings.
    codes : ndarray of int64, shape (Shown.n_words,)
        OPC UA status codes of `out`.
    """
    close_moment(p, c, f)
    h = record_at(f, 0, HEAD)
    if not _is_sound(f):
        h.count = 0.0
        h.restarts += 1.0
        for i in range(codes.shape[0]):
            codes[i] = BAD_OUT_OF_SERVICE
        return
    show(c, f, out)
    code = GOOD if is_read and out.state != NO_FIX else UNCERTAIN
    for i in range(codes.shape[0]):
        codes[i] = code
