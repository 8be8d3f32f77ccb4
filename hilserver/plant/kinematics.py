"""Steps 7 to 10 of the tick: from the side speeds to the velocity of the centre of mass.

Signs are those of the frame page: driving forward is left > 0, right < 0, and
``om = yaw_sign K_om (r_L w_L + r_R w_R)``. Every function returns velocities and their exact time
derivatives, v, vy, om and dv, dvy, dom, in m/s, rad/s and their rates.
"""

import math
from collections import namedtuple

from hilserver.compiled import inlined, part, plain
from hilserver.plant.layout import Parameters, State, Wheels
from hilserver.plant.units import RAD_S_PER_RPM

Velocity = tuple[float, float, float, float, float, float]


OfSpeeds = namedtuple(
    "OfSpeeds",
    "radius_left radius_right yaw_gain icr half_track base_turn gain_speed traction"
    " longitudinal_slip acceleration_slip side_slip misalignment surface_gain surface_speed"
    " gain_radius runout runout_phase",
)
"""What `velocity_terms` and `across` read; terms that need more than place and speeds are null.

Passed by value: compiled code keeps it in registers and computes several ticks at once.
"""


@plain
def nominal_gain(
    given: float,
    geometric_diff: float,
    mecanum: float,
    wheelbase_m: float,
    track_m: float,
) -> float:
    """Return K_om [1/m]: `given`, or if that is NaN the geometric value, (5.8) or (5.9)."""
    if not math.isnan(given):
        return given
    if mecanum != 0.0:
        return 1.0 / (wheelbase_m + track_m)
    if geometric_diff != 0.0 or math.isnan(wheelbase_m):
        return 1.0 / track_m
    return track_m / (wheelbase_m * wheelbase_m + track_m * track_m)


@inlined
def velocity_base(
    p: Parameters, w_l: float, w_r: float, dw_l: float, dw_r: float
) -> Velocity:
    """Return the velocity of the base model for side speeds [rad/s] and their rates [rad/s2]."""
    left, right = p.radius_left * w_l, p.radius_right * w_r
    dleft, dright = p.radius_left * dw_l, p.radius_right * dw_r
    om = p.yaw_gain * (left + right)
    dom = p.yaw_gain * (dleft + dright)
    return (
        0.5 * (left - right),
        -p.icr * om,
        om,
        0.5 * (dleft - dright),
        -p.icr * dom,
        dom,
    )


@inlined
def _apart(p: Parameters, speed: Wheels) -> float:
    """Return the speed to the left at which the wheels of each side turn apart."""
    left = p.radius_left * (speed[0] - speed[1])
    right = p.radius_right * (speed[2] - speed[3])
    return float(-0.25 * RAD_S_PER_RPM * p.roller_keep * (left + right))


@inlined
def sideways(p: Parameters, x: State) -> tuple[float, float]:
    """Return lateral speed [m/s] and its rate [m/s2] of mecanum wheels that turn as in `x`."""
    speed = _apart(p, x.speed)
    return speed, (_apart(p, x.motor) - speed) * p.inverse_t2


@inlined
def in_region(p: Parameters, px: float, py: float) -> bool:
    """Return whether a centre of mass at this point is on the patch of `surface_change`."""
    return bool(
        p.region_x_min <= px <= p.region_x_max
        and p.region_y_min <= py <= p.region_y_max
    )


@inlined
def turning_gain(
    p: Parameters,
    v0: float,
    dv0: float,
    w_l: float,
    w_r: float,
    dw_l: float,
    dw_r: float,
) -> tuple[float, float]:
    """Return the factor that speed and path radius apply to K_om, and its rate (step 9)."""
    speed, dspeed = abs(v0), dv0 if v0 >= 0.0 else -dv0
    gain = 1.0 + p.gain_speed * speed
    dgain = p.gain_speed * dspeed
    turn = p.base_turn * abs(w_l + w_r) * p.half_track
    whole = speed + turn
    if p.gain_radius != 0.0 and whole > 0.0:
        dsum = dw_l + dw_r
        dturn = p.base_turn * p.half_track * (dsum if w_l + w_r >= 0.0 else -dsum)
        share = 1.0 + p.gain_radius * speed / whole
        dshare = p.gain_radius * (dspeed * turn - speed * dturn) / (whole * whole)
        return gain * share, dgain * share + gain * dshare
    return gain, dgain


@part
def velocity_terms(
    p: Parameters,
    inside: bool,
    angle_left: float,
    w_l: float,
    w_r: float,
    dw_l: float,
    dw_r: float,
) -> tuple[float, float, float, float]:
    """Return v, om and their rates that the wheels produce, with the kinematic terms.

    The body may lag behind, so its lateral velocity is computed separately, in `across`.
    `angle_left` [rad] is the mean angle of the left wheels (`wheel_runout`). The rate of the
    acceleration_slip factor itself, which would need the wheels' jerk, is not part of `dv`.
    """
    wave, dwave = 1.0, 0.0
    if p.runout != 0.0:
        wave = 1.0 + p.runout * math.sin(angle_left + p.runout_phase)
        dwave = p.runout * math.cos(angle_left + p.runout_phase) * w_l
    left, right = p.radius_left * wave * w_l, p.radius_right * w_r
    dleft = p.radius_left * (dwave * w_l + wave * dw_l)
    dright = p.radius_right * dw_r
    v0, dv0 = 0.5 * (left - right), 0.5 * (dleft - dright)
    gain, dgain = turning_gain(p, v0, dv0, w_l, w_r, dw_l, dw_r)
    gain = gain * p.surface_gain if inside else gain
    dgain = dgain * p.surface_gain if inside else dgain
    om = p.yaw_gain * gain * (left + right)
    dom = p.yaw_gain * (dgain * (left + right) + gain * (dleft + dright))
    keep = 1.0 - p.longitudinal_slip * abs(om)
    dkeep = -p.longitudinal_slip * (dom if om >= 0.0 else -dom)
    grip = p.traction * max(0.0, 1.0 - p.acceleration_slip * abs(dv0))
    grip = grip * p.surface_speed if inside else grip
    return v0 * keep * grip, om, (dv0 * keep + v0 * dkeep) * grip, dom


@part
def across(
    p: Parameters, v: float, om: float, dv: float, dom: float
) -> tuple[float, float]:
    """Return the lateral velocity [m/s] of a body that moves so, and its rate [m/s2] (step 10)."""
    vy, dvy = -p.icr * om, -p.icr * dom
    if p.side_slip != 0.0:
        vy += p.side_slip * v * om
        dvy += p.side_slip * (dv * om + v * dom)
    if p.misalignment != 0.0:
        vy += p.misalignment * v
        dvy += p.misalignment * dv
    return vy, dvy


@inlined
def speeds_suffice(p: Parameters) -> bool:
    """Return whether the velocity now depends on place and wheel speeds alone."""
    return (
        p.gain_radius == 0.0
        and p.runout == 0.0
        and p.body_lag == 0.0
        and p.mecanum == 0.0
    )


@inlined
def of_speeds(p: Parameters) -> OfSpeeds:
    """Return the kinematic parameters of a robot for which speeds suffice."""
    return OfSpeeds(
        p.radius_left, p.radius_right, p.yaw_gain, p.icr, p.half_track, p.base_turn, p.gain_speed,
        p.traction, p.longitudinal_slip, p.acceleration_slip, p.side_slip, p.misalignment,
        p.surface_gain, p.surface_speed, 0.0, 0.0, 0.0,
    )  # fmt: skip
