"""Steps 7 to 10 of the tick: from the side speeds to the velocity of the centre of mass.

Signs are those of the frame page: driving forward is left > 0, right < 0, and
``om = yaw_sign K_om (r_L w_L + r_R w_R)``. Every function returns velocities and their exact time
derivatives, v, vy, om and dv, dvy, dom, in m/s, rad/s and their rates.
"""

import math
from typing import Any

import hilserver.plant.layout as at
from hilserver.plant.kernels import inlined, part
from hilserver.plant.units import RAD_S_PER_RPM

Velocity = tuple[float, float, float, float, float, float]


@inlined
def velocity_base(p: Any, w_l: float, w_r: float, dw_l: float, dw_r: float) -> Velocity:
    """Return the velocity of the base model for side speeds [rad/s] and their rates [rad/s2]."""
    left, right = p[at.P_RADIUS_LEFT] * w_l, p[at.P_RADIUS_RIGHT] * w_r
    dleft, dright = p[at.P_RADIUS_LEFT] * dw_l, p[at.P_RADIUS_RIGHT] * dw_r
    om = p[at.P_YAW_GAIN] * (left + right)
    dom = p[at.P_YAW_GAIN] * (dleft + dright)
    return (
        0.5 * (left - right),
        -p[at.P_ICR] * om,
        om,
        0.5 * (dleft - dright),
        -p[at.P_ICR] * dom,
        dom,
    )


@inlined
def _apart(p: Any, x: Any, first: int) -> float:
    """Return by how much the wheels of each side turn apart, as speed to the left."""
    left = p[at.P_RADIUS_LEFT] * (x[first] - x[first + 1])
    right = p[at.P_RADIUS_RIGHT] * (x[first + 2] - x[first + 3])
    return float(-0.25 * RAD_S_PER_RPM * p[at.P_ROLLER_KEEP] * (left + right))


@part
def sideways(p: Any, x: Any) -> tuple[float, float]:
    """Return lateral speed [m/s] and its rate [m/s2] of mecanum wheels that turn as `x` says."""
    speed = _apart(p, x, at.X_SPEED)
    return speed, (_apart(p, x, at.X_MOTOR) - speed) * p[at.P_INVERSE_T2]


@part
def in_region(p: Any, x: Any) -> bool:
    """Return whether the centre of mass stands on the patch of `surface_change`."""
    return bool(
        p[at.P_REGION_X_MIN] <= x[at.X_POSE] <= p[at.P_REGION_X_MAX]
        and p[at.P_REGION_Y_MIN] <= x[at.X_POSE + 1] <= p[at.P_REGION_Y_MAX]
    )


@part
def turning_gain(
    p: Any, v0: float, dv0: float, w_l: float, w_r: float, dw_l: float, dw_r: float
) -> tuple[float, float]:
    """Return the factor on K_om that speed and path radius make, and its rate (step 9)."""
    speed, dspeed = abs(v0), dv0 if v0 >= 0.0 else -dv0
    gain = 1.0 + p[at.P_GAIN_SPEED] * speed
    dgain = p[at.P_GAIN_SPEED] * dspeed
    turn = p[at.P_BASE_TURN] * abs(w_l + w_r) * p[at.P_HALF_TRACK]
    whole = speed + turn
    if p[at.P_GAIN_RADIUS] != 0.0 and whole > 0.0:
        dsum = dw_l + dw_r
        dturn = p[at.P_BASE_TURN] * p[at.P_HALF_TRACK] * (dsum if w_l + w_r >= 0.0 else -dsum)
        share = 1.0 + p[at.P_GAIN_RADIUS] * speed / whole
        dshare = p[at.P_GAIN_RADIUS] * (dspeed * turn - speed * dturn) / (whole * whole)
        return gain * share, dgain * share + gain * dshare
    return gain, dgain


@part
def velocity_terms(
    p: Any,
    inside: bool,
    angle_left: float,
    w_l: float,
    w_r: float,
    dw_l: float,
    dw_r: float,
) -> tuple[float, float, float, float]:
    """Return v, om and their rates as the wheels make them, with the kinematic terms.

    The body may lag behind them, so its lateral velocity is left to `across`. `angle_left` [rad] is
    the mean angle of the left wheels (`wheel_runout`). The rate of the acceleration_slip factor
    itself, which would need the wheels' jerk, is left out of `dv`.
    """
    wave, dwave = 1.0, 0.0
    if p[at.P_RUNOUT] != 0.0:
        wave = 1.0 + p[at.P_RUNOUT] * math.sin(angle_left + p[at.P_RUNOUT_PHASE])
        dwave = p[at.P_RUNOUT] * math.cos(angle_left + p[at.P_RUNOUT_PHASE]) * w_l
    left, right = p[at.P_RADIUS_LEFT] * wave * w_l, p[at.P_RADIUS_RIGHT] * w_r
    dleft = p[at.P_RADIUS_LEFT] * (dwave * w_l + wave * dw_l)
    dright = p[at.P_RADIUS_RIGHT] * dw_r
    v0, dv0 = 0.5 * (left - right), 0.5 * (dleft - dright)
    gain, dgain = turning_gain(p, v0, dv0, w_l, w_r, dw_l, dw_r)
    gain = gain * p[at.P_SURFACE_GAIN] if inside else gain
    dgain = dgain * p[at.P_SURFACE_GAIN] if inside else dgain
    om = p[at.P_YAW_GAIN] * gain * (left + right)
    dom = p[at.P_YAW_GAIN] * (dgain * (left + right) + gain * (dleft + dright))
    keep = 1.0 - p[at.P_LONGITUDINAL_SLIP] * abs(om)
    dkeep = -p[at.P_LONGITUDINAL_SLIP] * (dom if om >= 0.0 else -dom)
    grip = p[at.P_TRACTION] * max(0.0, 1.0 - p[at.P_ACCELERATION_SLIP] * abs(dv0))
    grip = grip * p[at.P_SURFACE_SPEED] if inside else grip
    return v0 * keep * grip, om, (dv0 * keep + v0 * dkeep) * grip, dom


@part
def across(p: Any, v: float, om: float, dv: float, dom: float) -> tuple[float, float]:
    """Return the lateral velocity [m/s] of a body with these, and its rate [m/s2] (step 10)."""
    vy, dvy = -p[at.P_ICR] * om, -p[at.P_ICR] * dom
    if p[at.P_SIDE_SLIP] != 0.0:
        vy += p[at.P_SIDE_SLIP] * v * om
        dvy += p[at.P_SIDE_SLIP] * (dv * om + v * dom)
    if p[at.P_MISALIGNMENT] != 0.0:
        vy += p[at.P_MISALIGNMENT] * v
        dvy += p[at.P_MISALIGNMENT] * dv
    return vy, dvy
