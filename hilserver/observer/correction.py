"""Corrects the estimate with samples, and rejects samples that are too far off.

Uncertain parameters are considered, not estimated (Schmidt's filter): only the state has a gain, so
their variance stays and keeps what depends on them uncertain.
"""

import math
from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.observer.layout import (
    BIAS,
    FIGURES,
    GAIN,
    N_ESTIMATED,
    OU_X,
    OU_Y,
    OU_YAW,
    SLIP,
    YAW,
    Figures,
    Head,
    Moment,
    X,
    Y,
)
from hilserver.observer.motion import rolled
from hilserver.observer.sensors import (
    gyro_row,
    gyro_shared,
    position_rows,
    position_shared,
    show_gyro,
    show_position,
    show_yaw,
    yaw_row,
    yaw_shared,
)
from hilserver.plant.layout import Parameters
from hilserver.plant.pose import wrap

GATE_1, GATE_2 = 15.137, 18.421
"""Normalised squared innovations (1 and 2 values) that 1 of 10,000 good samples exceeds."""
UNKNOWN_M2, UNKNOWN_RAD2 = (
    1e6,
    1e2,
)  # variances of an unknown place and an unknown heading


@part
def _weigh(m: Moment, n: int, row: int, h: Head) -> None:
    """Write the covariance of state and directions with a reading to `h`."""
    for i in range(N_ESTIMATED):
        total = 0.0
        for j in range(N_ESTIMATED):
            total += m.covariance[i, j] * h.rows[row, j]
        for j in range(n):
            total += m.cross[i, j] * h.shared[row, j]
        h.weight[i] = total
    for j in range(n):
        total = h.shared[row, j]
        for i in range(N_ESTIMATED):
            total += m.cross[i, j] * h.rows[row, i]
        h.weight_shared[j] = total


@inlined
def _spread(n: int, row: int, h: Head) -> float:
    """Return the covariance of the weighed reading with that of `row`, without noise."""
    total = 0.0
    for i in range(N_ESTIMATED):
        total += h.rows[row, i] * h.weight[i]
    for j in range(n):
        total += h.shared[row, j] * h.weight_shared[j]
    return total


@part
def _correct(m: Moment, n: int, h: Head, innovation: float, variance: float) -> None:
    """Apply the reading that was weighed."""
    share = 1.0 / variance
    for i in range(N_ESTIMATED):
        gain = h.weight[i] * share
        m.estimate[i] += gain * innovation
        for j in range(N_ESTIMATED):
            m.covariance[i, j] -= gain * h.weight[j]
        for j in range(n):
            m.cross[i, j] -= gain * h.weight_shared[j]


@inlined
def forget(m: Moment, place: int, variance: float) -> None:
    """Make a state unknown, uncorrelated with all others."""
    for i in range(N_ESTIMATED):
        m.covariance[place, i] = m.covariance[i, place] = 0.0
    for j in range(m.cross.shape[1]):
        m.cross[place, j] = 0.0
    m.covariance[place, place] = variance


@part
def take_gyro(p: Parameters, c: Any, h: Head, m: Moment, dt: float) -> None:
    """Correct with the turn rate that the gyro shows."""
    figures = record_at(c, 0, FIGURES)
    n = int(figures.considered)
    gyro_row(p, h.rows[0])
    gyro_shared(p, c, m, h)
    _weigh(m, n, 0, h)
    variance = (
        _spread(n, 0, h) + figures.gyro_sd * figures.gyro_sd + figures.gyro_drift / dt
    )
    shown = show_gyro(p, m.estimate, m.gyro_back, m.turning)
    _correct(m, n, h, m.gyro - shown, variance)


@part
def take_yaw(p: Parameters, c: Any, h: Head, m: Moment, is_new: bool) -> None:
    """Correct with a heading unless it is too far off."""
    figures = record_at(c, 0, FIGURES)
    n = int(figures.considered)
    if m.refused_yaw + 1.0 >= figures.readmit_after:
        forget(m, YAW, UNKNOWN_RAD2)
        m.fixed_yaw = m.refused_yaw = 0.0
        h.readmitted += is_new
    yaw_row(p, m.estimate, m.yaw_back, h.rows[0])
    yaw_shared(p, c, m.estimate, m.yaw_back, h)
    _weigh(m, n, 0, h)
    variance = _spread(n, 0, h) + figures.yaw_sd * figures.yaw_sd
    innovation = wrap(m.yaw - show_yaw(p, m.estimate, m.yaw_back))
    nis = innovation * innovation / variance
    if m.fixed_yaw != 0.0:
        m.nis = nis
        if nis > GATE_1:
            m.refused_yaw += 1.0
            h.rejected += is_new
            return
    _correct(m, n, h, innovation, variance)
    m.fixed_yaw, m.refused_yaw, m.last_fix = 1.0, 0.0, m.time
    h.accepted += is_new


@part
def take_position(p: Parameters, c: Any, h: Head, m: Moment, is_new: bool) -> None:
    """Correct with a position unless it is too far off."""
    figures = record_at(c, 0, FIGURES)
    n, noise = int(figures.considered), figures.position_sd * figures.position_sd
    if m.refused_position + 1.0 >= figures.readmit_after:
        forget(m, X, UNKNOWN_M2)
        forget(m, Y, UNKNOWN_M2)
        m.fixed_position = m.refused_position = 0.0
        h.readmitted += is_new
    aside = rolled(p, m)
    position_rows(p, m.estimate, aside, m.position_back, h.rows)
    position_shared(p, c, m, h)
    px, py = show_position(p, m.estimate, aside, m.position_back)
    ix, iy = m.position[0] - px, m.position[1] - py
    _weigh(m, n, 1, h)
    syy = _spread(n, 1, h) + noise
    _weigh(m, n, 0, h)
    sxx, sxy = _spread(n, 0, h) + noise, _spread(n, 1, h)
    nis = (syy * ix * ix - 2.0 * sxy * ix * iy + sxx * iy * iy) / (
        sxx * syy - sxy * sxy
    )
    if m.fixed_position != 0.0:
        m.nis = 0.5 * nis
        if nis > GATE_2:
            m.refused_position += 1.0
            h.rejected += is_new
            return
    _correct(m, n, h, ix, sxx)
    iy -= sxy / sxx * ix
    _weigh(m, n, 1, h)
    _correct(m, n, h, iy, _spread(n, 1, h) + noise)
    m.fixed_position, m.refused_position, m.last_fix = 1.0, 0.0, m.time
    h.accepted += is_new


@inlined
def begin(c: Figures, m: Moment) -> None:
    """Begin with an unknown pose and, for the rest, the variances of the figures."""
    for i in range(N_ESTIMATED):
        m.estimate[i] = 0.0
        forget(m, i, 0.0)
    m.covariance[X, X] = m.covariance[Y, Y] = UNKNOWN_M2
    m.covariance[YAW, YAW] = UNKNOWN_RAD2
    m.covariance[BIAS, BIAS] = c.bias_sd * c.bias_sd
    m.covariance[OU_X, OU_X] = m.covariance[OU_Y, OU_Y] = c.position_ou * c.position_ou
    m.covariance[OU_YAW, OU_YAW] = c.yaw_ou * c.yaw_ou
    m.covariance[SLIP, SLIP] = c.slip_sd * c.slip_sd
    m.covariance[GAIN, GAIN] = c.gain_sd * c.gain_sd
    m.nis = math.nan
