"""The measurement model: what the sensors show in a state, and its derivatives.

A sample may be older, by less than a step, than the moment it is assigned to: `back` [s].
"""

import math
from typing import Any

from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.observer.layout import (
    BIAS,
    FIGURES,
    N_ESTIMATED,
    N_FIGURES,
    N_PARAMETERS,
    OM,
    OU_X,
    OU_Y,
    OU_YAW,
    YAW,
    Head,
    Moment,
    V,
    X,
    Y,
)
from hilserver.observer.motion import rolled, shift, shift_by
from hilserver.plant.layout import PARAMETERS, Parameters


@part
def show_position(
    p: Parameters, x: Any, aside: float, back: float
) -> tuple[float, float]:
    """Return the position [m] that the tag shows; `aside` [m/s] is the speed to the left."""
    dx, dy = shift(p, x[YAW], x[V], x[OM], aside, -back)
    yaw = x[YAW] - x[OM] * back
    cos, sin = math.cos(yaw), math.sin(yaw)
    px = x[X] + dx + p.lever_x * cos - p.lever_y * sin
    py = x[Y] + dy + p.lever_x * sin + p.lever_y * cos
    wave = p.nav_bias_wave
    return (
        p.nav_scale * px + p.nav_bias * math.cos(wave * py) + x[OU_X],
        p.nav_scale * py + p.nav_bias * math.cos(wave * px) + x[OU_Y],
    )


@inlined
def position_rows(p: Parameters, x: Any, aside: float, back: float, rows: Any) -> None:
    """Write the derivatives of `show_position` by the state to `rows`, shape (2, N_ESTIMATED)."""
    dx, dy = shift(p, x[YAW], x[V], x[OM], aside, -back)
    x_v, y_v, x_om, y_om = shift_by(p, x[YAW], x[V], x[OM], aside, -back)
    yaw = x[YAW] - x[OM] * back
    cos, sin = math.cos(yaw), math.sin(yaw)
    arm_x, arm_y = p.lever_x * cos - p.lever_y * sin, p.lever_x * sin + p.lever_y * cos
    wave, scale = p.nav_bias_wave, p.nav_scale
    by_x = -p.nav_bias * wave * math.sin(wave * (x[X] + dx + arm_x))
    by_y = -p.nav_bias * wave * math.sin(wave * (x[Y] + dy + arm_y))
    for j in range(N_ESTIMATED):
        rows[0, j] = rows[1, j] = 0.0
    for place, px, py in (
        (X, 1.0, 0.0),
        (Y, 0.0, 1.0),
        (YAW, -dy - arm_y, dx + arm_x),
        (V, x_v, y_v),
        (OM, x_om + back * arm_y, y_om - back * arm_x),
    ):
        rows[0, place] = scale * px + by_y * py
        rows[1, place] = scale * py + by_x * px
    rows[0, OU_X] = rows[1, OU_Y] = 1.0


@part
def show_yaw(p: Parameters, x: Any, back: float) -> float:
    """Return the heading [rad] that the tag shows, not wrapped."""
    yaw = x[YAW] - x[OM] * back
    once = p.distortion_1 * math.sin(yaw + p.distortion_phase_1)
    twice = p.distortion_2 * math.sin(2.0 * yaw + p.distortion_phase_2)
    return float(yaw + once + twice + p.nav_frame_yaw + x[OU_YAW])


@inlined
def yaw_row(p: Parameters, x: Any, back: float, row: Any) -> None:
    """Write the derivative of `show_yaw` by the state to `row`, shape (N_ESTIMATED,)."""
    yaw = x[YAW] - x[OM] * back
    once = p.distortion_1 * math.cos(yaw + p.distortion_phase_1)
    twice = 2.0 * p.distortion_2 * math.cos(2.0 * yaw + p.distortion_phase_2)
    for j in range(N_ESTIMATED):
        row[j] = 0.0
    row[YAW] = 1.0 + once + twice
    row[OM] = -back * row[YAW]
    row[OU_YAW] = 1.0


@inlined
def show_gyro(p: Parameters, x: Any, back: float, turning: float) -> float:
    """Return the turn rate [rad/s] that the gyro shows, if it changes by `turning` [rad/s2]."""
    return float(p.gyro_gain * (x[OM] - back * turning) + p.gyro_bias + x[BIAS])


@inlined
def gyro_row(p: Parameters, row: Any) -> None:
    """Write the derivative of `show_gyro` by the state to `row`, shape (N_ESTIMATED,)."""
    for j in range(N_ESTIMATED):
        row[j] = 0.0
    row[OM], row[BIAS] = p.gyro_gain, 1.0


@inlined
def position_shared(p: Parameters, c: Any, m: Moment, h: Head) -> None:
    """Write the effect of one deviation of each direction on a position to `h.shared`."""
    figures = record_at(c, 0, FIGURES)
    x, back = m.estimate, m.position_back
    px, py = show_position(p, x, rolled(p, m), back)
    h.shared[0, int(figures.directions)] = h.shared[1, int(figures.directions)] = 0.0
    for j in range(int(figures.directions)):
        other = record_at(c, N_FIGURES + j * N_PARAMETERS, PARAMETERS)
        older = (other.nav_delay - p.nav_delay) * figures.nav_period
        qx, qy = show_position(other, x, rolled(other, m), back + older)
        h.shared[0, j], h.shared[1, j] = qx - px, qy - py


@inlined
def yaw_shared(p: Parameters, c: Any, x: Any, back: float, h: Head) -> None:
    """Write the effect of one deviation of each direction on a heading to `h.shared`."""
    figures = record_at(c, 0, FIGURES)
    shown = show_yaw(p, x, back)
    h.shared[0, int(figures.directions)] = 0.0
    for j in range(int(figures.directions)):
        other = record_at(c, N_FIGURES + j * N_PARAMETERS, PARAMETERS)
        older = (other.nav_yaw_delay - p.nav_yaw_delay) * figures.nav_period
        h.shared[0, j] = show_yaw(other, x, back + older) - shown


@inlined
def gyro_shared(p: Parameters, c: Any, m: Moment, h: Head) -> None:
    """Write the effect of one deviation of each direction on a gyro reading to `h.shared`."""
    figures, back = record_at(c, 0, FIGURES), m.gyro_back
    shown = show_gyro(p, m.estimate, back, m.turning)
    h.shared[0, int(figures.directions)] = 0.0
    for j in range(int(figures.directions)):
        other = record_at(c, N_FIGURES + j * N_PARAMETERS, PARAMETERS)
        older = (other.imu_delay - p.imu_delay) * figures.imu_period
        h.shared[0, j] = show_gyro(other, m.estimate, back + older, m.turning) - shown
