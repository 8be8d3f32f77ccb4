"""From one moment to the next: the plant's kinematics, driven by the wheels' measured speeds.

Speed and turn rate are those of a moment; the pose moves with the means of two of them.
`transition` is the exact derivative of `move_on` by the state.
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
    N_FIGURES,
    N_PARAMETERS,
    OM,
    OU_X,
    OU_Y,
    OU_YAW,
    SLIP,
    YAW,
    FilterFigures,
    Head,
    Moment,
    V,
    X,
    Y,
)
from hilserver.plant.kinematics import across, in_region, velocity_terms
from hilserver.plant.layout import PARAMETERS, Parameters
from hilserver.plant.pose import shift as of_arc
from hilserver.plant.pose import sinc
from hilserver.plant.robot import SLOPE_REST_RAD_S

_FLAT_RAD = 1e-3  # below this, the derivative of sinc is its first term
BEND = 1.0 / math.sqrt(48.0)
"""Standard deviation of the mean over a step, per unit of bend, if a wheel jumps within the step.

A jump by J at an unknown instant gives the step's mean the variance J2 / 12. Half of this is common
to all jumps, as commands and samples keep step (`figures.INSTANT_SD`). The half of its own appears
in two bends, J and -J.
"""
CLEAR = 3.0  # standard deviations of noise up to which a bend is ignored


@inlined
def _dsinc(half: float) -> float:
    if abs(half) < _FLAT_RAD:
        return -half / 3.0
    return (math.cos(half) - math.sin(half) / half) / half


@part
def bend(time: float, left: float, right: float, before: Moment, now: Moment) -> None:
    """Write the bend of the wheel speeds at `before`, given an earlier sample [s, rad/s]."""
    ratio = (now.time - before.time) / (before.time - time)
    now.bend_left = now.left - before.left - ratio * (before.left - left)
    now.bend_right = now.right - before.right - ratio * (before.right - right)


@part
def wheel_velocity(p: Parameters, before: Moment, now: Moment) -> tuple[float, float]:
    """Return the speed [m/s] and turn rate [rad/s] that the wheels of a moment produce."""
    inside = in_region(p, before.estimate[X], before.estimate[Y])
    dt, (left, right) = now.time - before.time, _sides(p, now)
    left_before, right_before = _sides(p, before)
    dleft, dright = (left - left_before) / dt, (right - right_before) / dt
    v, om, _, _ = velocity_terms(p, inside, now.angle_left, left, right, dleft, dright)
    return v, om


@inlined
def _turned(
    p: Parameters, front: int, mean: float, apart: float
) -> tuple[float, float]:
    """Return mean and difference of a side's wheel speeds [rad/s] from those of its encoders."""
    ahead = (mean + 0.5 * apart) / p.encoder_gain[front]
    behind = (mean - 0.5 * apart) / p.encoder_gain[front + 1]
    return 0.5 * (ahead + behind), ahead - behind


@inlined
def _sides(p: Parameters, m: Moment) -> tuple[float, float]:
    """Return the mean speeds of the wheels of both sides [rad/s]."""
    return _turned(p, 0, m.left, m.apart_left)[0], _turned(
        p, 2, m.right, m.apart_right
    )[0]


@inlined
def rolled(p: Parameters, m: Moment) -> float:
    """Return the speed to the left [m/s] from mecanum wheels; 0 for other wheels."""
    left = p.radius_left * _turned(p, 0, m.left, m.apart_left)[1]
    right = p.radius_right * _turned(p, 2, m.right, m.apart_right)[1]
    return float(-0.25 * p.mecanum * p.roller_keep * (left + right))


@inlined
def rolling(p: Parameters, m: Moment) -> float:
    """Return how fast the wheels roll on average [m/s], in whatever direction."""
    left = p.radius_left * (abs(m.left) + 0.5 * abs(m.apart_left))
    right = p.radius_right * (abs(m.right) + 0.5 * abs(m.apart_right))
    return float(0.5 * (left + right))


@inlined
def share_closed(p: Parameters, dt: float) -> float:
    """Return the share by which the body catches up with its wheels in `dt` [s]; 1 without lag."""
    return 1.0 if p.body_lag == 0.0 else -math.expm1(-dt / p.body_lag)


@inlined
def shift(
    p: Parameters, yaw: float, v: float, om: float, aside: float, dt: float
) -> tuple[float, float]:
    """Return how far [m] the robot moves in `dt` [s] with constant velocities."""
    vy = across(p, v, om, 0.0, 0.0)[0] + aside
    dx, dy = of_arc(yaw, v, vy, om, dt)
    return dx, dy


@part
def shift_by(
    p: Parameters, yaw: float, v: float, om: float, aside: float, dt: float
) -> tuple[float, float, float, float]:
    """Return the derivatives of `shift` by speed (x, y) and by turn rate (x, y)."""
    vy = across(p, v, om, 0.0, 0.0)[0] + aside
    vy_v, vy_om = p.side_slip * om + p.misalignment, p.side_slip * v - p.icr
    half = 0.5 * om * dt
    chord, heading = dt * sinc(half), yaw + half
    cos, sin = math.cos(heading), math.sin(heading)
    ahead_x, ahead_y = v * cos - vy * sin, v * sin + vy * cos
    grow = 0.5 * dt * dt * _dsinc(half)
    turn = 0.5 * dt * chord
    return (
        chord * (cos - vy_v * sin),
        chord * (sin + vy_v * cos),
        grow * ahead_x - turn * ahead_y - chord * vy_om * sin,
        grow * ahead_y + turn * ahead_x + chord * vy_om * cos,
    )


@part
def move_on(
    p: Parameters, c: FilterFigures, before: Moment, now: Moment, out: Any
) -> None:
    """Write the state predicted from the moment before to `out`, shape (N_ESTIMATED,)."""
    x, dt = before.estimate, now.time - before.time
    v_wheels, om_wheels = wheel_velocity(p, before, now)
    closed = share_closed(p, dt)
    v = x[V] + closed * (v_wheels * (1.0 + x[SLIP]) - x[V])
    om = x[OM] + closed * (om_wheels * (1.0 + x[GAIN]) - x[OM])
    v_mean, om_mean = 0.5 * (x[V] + v), 0.5 * (x[OM] + om)
    aside = 0.5 * (rolled(p, before) + rolled(p, now))
    dx, dy = shift(p, x[YAW], v_mean, om_mean, aside, dt)
    if abs(now.left) + abs(now.right) > SLOPE_REST_RAD_S:
        dx += p.slope_x * dt
        dy += p.slope_y * dt
    out[X], out[Y], out[YAW] = x[X] + dx, x[Y] + dy, x[YAW] + om_mean * dt
    out[V], out[OM], out[BIAS] = v, om, x[BIAS]
    out[OU_X] = x[OU_X] * _kept(dt, c.position_tau)
    out[OU_Y] = x[OU_Y] * _kept(dt, c.position_tau)
    out[OU_YAW] = x[OU_YAW] * _kept(dt, c.yaw_tau)
    out[SLIP], out[GAIN] = x[SLIP], x[GAIN]


@inlined
def _kept(dt: float, tau: float) -> float:
    return math.exp(-dt / tau) if tau > 0.0 else 0.0


@part
def _transform(m: Any, k: int, n: int, f: Any) -> None:
    """Multiply columns k to n of `m` by F, given as `f` from `transition`."""
    for j in range(k, n):
        v, om, slip, gain = m[V, j], m[OM, j], m[SLIP, j], m[GAIN, j]
        m[X, j] += f[0] * m[YAW, j] + f[1] * v + f[2] * om + f[3] * slip + f[4] * gain
        m[Y, j] += f[5] * m[YAW, j] + f[6] * v + f[7] * om + f[8] * slip + f[9] * gain
        m[YAW, j] += f[10] * om + f[11] * gain
        m[V, j] = f[12] * v + f[13] * slip
        m[OM, j] = f[12] * om + f[14] * gain
        m[OU_X, j] *= f[15]
        m[OU_Y, j] *= f[15]
        m[OU_YAW, j] *= f[16]


@part
def transition(p: Parameters, c: FilterFigures, before: Moment, now: Moment) -> Any:
    """Return the entries of F = d `move_on` / d state that are not 0 or 1, then those of the means.

    Returns
    -------
    tuple of float
        Rows x and y by yaw, v, om, slip, gain; yaw by om, gain; v and om by themselves, by slip, by
        gain; the correlated errors of position and yaw by themselves; then x, y by the moment's
        speed, and by its turn rate.
    """
    x, dt = before.estimate, now.time - before.time
    v_wheels, om_wheels = wheel_velocity(p, before, now)
    closed = share_closed(p, dt)
    keep = 1.0 - closed
    v = x[V] + closed * (v_wheels * (1.0 + x[SLIP]) - x[V])
    om = x[OM] + closed * (om_wheels * (1.0 + x[GAIN]) - x[OM])
    v_mean, om_mean = 0.5 * (x[V] + v), 0.5 * (x[OM] + om)
    aside = 0.5 * (rolled(p, before) + rolled(p, now))
    dx, dy = shift(p, x[YAW], v_mean, om_mean, aside, dt)
    x_v, y_v, x_om, y_om = shift_by(p, x[YAW], v_mean, om_mean, aside, dt)
    half, by_slip, by_gain = 0.5 * (1.0 + keep), closed * v_wheels, closed * om_wheels
    return (
        -dy, half * x_v, half * x_om, 0.5 * by_slip * x_v, 0.5 * by_gain * x_om,
        dx, half * y_v, half * y_om, 0.5 * by_slip * y_v, 0.5 * by_gain * y_om,
        half * dt, 0.5 * dt * by_gain,
        keep, by_slip, by_gain,
        _kept(dt, c.position_tau), _kept(dt, c.yaw_tau),
        0.5 * x_v, 0.5 * y_v, 0.5 * x_om, 0.5 * y_om,
    )  # fmt: skip


@inlined
def _wheel_noise(
    p: Parameters, c: FilterFigures, before: Moment, now: Moment, f: Any, h: Head
) -> None:
    """Write the effect of one standard deviation of the wheels' noise on the step.

    Rows 0 and 1: noise of either side's reading. Rows 2 and 3: motion of the wheels between two
    readings, which changes only the means of speed and turn rate. Row 4: noise to the side, where
    the difference of two readings has twice the noise of their mean.
    """
    dt = now.time - before.time
    sd = math.sqrt(c.wheel_sd * c.wheel_sd + c.wheel_drift / dt) * share_closed(p, dt)
    left = p.radius_left * _turned(p, 0, 1.0, 0.0)[0]
    right = p.radius_right * _turned(p, 2, 1.0, 0.0)[0]
    v_left, v_right = 0.5 * p.traction * left, -0.5 * p.traction * right
    om_left, om_right = p.yaw_gain * left, p.yaw_gain * right
    _noise_row(h.noise[0], f, dt, sd * v_left, sd * om_left)
    _noise_row(h.noise[1], f, dt, sd * v_right, sd * om_right)
    h.noise[0, V], h.noise[0, OM] = sd * v_left, sd * om_left
    h.noise[1, V], h.noise[1, OM] = sd * v_right, sd * om_right
    least = CLEAR * math.sqrt(6.0) * c.wheel_sd
    bent_left = now.bend_left if abs(now.bend_left) > least else 0.0
    bent_right = now.bend_right if abs(now.bend_right) > least else 0.0
    bend_v = v_left * bent_left + v_right * bent_right
    bend_om = om_left * bent_left + om_right * bent_right
    _noise_row(h.noise[2], f, dt, 2.0 * BEND * bend_v, 0.0)
    _noise_row(h.noise[3], f, dt, 0.0, 2.0 * BEND * bend_om)
    ahead, both = before.estimate[YAW], math.hypot(left, right)
    aside = 0.5 * dt * sd * p.mecanum * p.roller_keep * both
    h.noise[4, X], h.noise[4, Y] = -aside * math.sin(ahead), aside * math.cos(ahead)


@part
def _noise_row(row: Any, f: Any, dt: float, dv: float, dom: float) -> None:
    """Write the effect on the pose of a change of the newer of both velocities."""
    row[X], row[Y] = f[17] * dv + f[19] * dom, f[18] * dv + f[20] * dom
    row[YAW], row[V], row[OM] = 0.5 * dt * dom, 0.0, 0.0


@inlined
def _pushes(c: Any, before: Moment, now: Moment, h: Head) -> None:
    """Write the effect on the step of one deviation of each direction of uncertain parameters."""
    figures = record_at(c, 0, FIGURES)
    for j in range(int(figures.directions)):
        other = record_at(c, N_FIGURES + j * N_PARAMETERS, PARAMETERS)
        move_on(other, figures, before, now, h.weight)
        for i in range(OM + 1):
            h.push[i, j] = h.weight[i] - now.estimate[i]
    if figures.considered > figures.directions:
        _push_instant(figures, before, now, h)


@inlined
def _push_instant(c: FilterFigures, before: Moment, now: Moment, h: Head) -> None:
    """Write the effect of one deviation of the wheels' instant: the pose of a little later."""
    j, late = int(c.directions), c.instant_sd * (now.time - before.time)
    dv = late * (now.estimate[V] - before.estimate[V])
    for i in range(OM + 1):
        h.push[i, j] = 0.0
    h.push[X, j], h.push[Y, j] = (
        dv * math.cos(now.estimate[YAW]),
        dv * math.sin(now.estimate[YAW]),
    )
    h.push[YAW, j] = late * (now.estimate[OM] - before.estimate[OM])


@inlined
def _add_noise(c: FilterFigures, dt: float, way: float, h: Head, m: Any) -> None:
    """Add the covariance of a step's noise to `m`, shape (N_ESTIMATED, N_ESTIMATED)."""
    for k in range(h.noise.shape[0]):
        row = h.noise[k]
        for i in range(OM + 1):
            for j in range(OM + 1):
                m[i, j] += row[i] * row[j]
    position, yaw = _kept(dt, c.position_tau), _kept(dt, c.yaw_tau)
    m[OU_X, OU_X] += c.position_ou * c.position_ou * (1.0 - position * position)
    m[OU_Y, OU_Y] += c.position_ou * c.position_ou * (1.0 - position * position)
    m[OU_YAW, OU_YAW] += c.yaw_ou * c.yaw_ou * (1.0 - yaw * yaw)
    m[X, X] += c.roam * way
    m[Y, Y] += c.roam * way
    m[YAW, YAW] += c.roam_yaw * way
    m[BIAS, BIAS] += c.bias_walk * dt
    m[SLIP, SLIP] += c.slip_walk * dt
    m[GAIN, GAIN] += c.gain_walk * dt


@part
def predict(p: Parameters, c: Any, h: Head, before: Moment, now: Moment) -> None:
    """Carry estimate and covariance to a later moment.

    With the directions z of uncertain parameters, which stay as they are (P_zz = 1), C = P_xz and
    x' = F x + G z: C' = F C + G and P' = F P F^T + F C G^T + G C'^T + Q.

    Parameters
    ----------
    c : ndarray
        `FilterFigures`, followed by the parameters at one deviation of each direction.
    before, now : Moment
        `now` has its time and wheel speeds; estimate and covariance are written.
    """
    figures, dt = record_at(c, 0, FIGURES), now.time - before.time
    n = int(figures.considered)
    m, cross = now.covariance, now.cross
    move_on(p, figures, before, now, now.estimate)
    now.turning = (now.estimate[OM] - before.estimate[OM]) / dt
    f = transition(p, figures, before, now)
    for i in range(N_ESTIMATED):
        for j in range(N_ESTIMATED):
            m[i, j] = before.covariance[i, j]
        for j in range(n):
            cross[i, j] = before.cross[i, j]
    _transform(m, 0, N_ESTIMATED, f)
    _transform(m.T, 0, N_ESTIMATED, f)
    if n > 0:
        _pushes(c, before, now, h)
        _transform(cross, 0, n, f)
        for k in range(n):
            for i in range(N_ESTIMATED):
                for j in range(OM + 1):
                    m[i, j] += cross[i, k] * h.push[j, k]
            for i in range(OM + 1):
                cross[i, k] += h.push[i, k]
            for i in range(OM + 1):
                for j in range(N_ESTIMATED):
                    m[i, j] += h.push[i, k] * cross[j, k]
    _wheel_noise(p, figures, before, now, f, h)
    _add_noise(figures, dt, rolling(p, now) * dt, h, m)
