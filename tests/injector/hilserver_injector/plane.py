"""How the body moves: plain kinematics, or tyre forces under a body with mass."""

import math
from typing import Any

from hilserver_injector.compiled import kernel
from hilserver_injector.parameters import K_OM, RADIUS_M, TRACK_M, WHEELBASE_M

RAD_S = math.pi / 30.0
GRAVITY, GRIP, SLIP_FLOOR_M_S = 9.81, 0.7, 0.004
GYRATION2_M2 = (0.40**2 + 0.35**2) / 12.0
"""Moment of inertia by mass of a box of the robot's size."""


@kernel
def kinematic(
    p: Any, left: float, right: float, accel: float, angle: float, inside: bool
) -> tuple[float, float]:
    """Return v, om for side speeds [rpm] and the acceleration of their mean forward [rpm/s]."""
    r_left = p.radius_left
    if p.runout != 0.0:
        r_left *= 1.0 + p.runout * math.sin(angle + p.runout_phase)
    rim_l, rim_r = r_left * left * RAD_S, p.radius_right * right * RAD_S
    v0 = 0.5 * (rim_l - rim_r)
    k = p.k_om * (1.0 + p.gain_speed * abs(v0))
    if p.gain_radius != 0.0:
        turn = RADIUS_M * K_OM * abs(left + right) * RAD_S * TRACK_M * 0.5
        share = abs(v0) / max(abs(v0) + turn, 1e-12)
        k *= 1.0 + p.gain_radius * share
    v = v0 * (1.0 - p.traction)
    if inside:
        k *= p.surface_k
        v *= p.surface_v
    om = k * (rim_l + rim_r)
    v *= 1.0 - p.slip * abs(om)
    if p.accel_slip != 0.0:
        v *= max(
            0.0,
            1.0 - p.accel_slip * abs(0.5 * (r_left + p.radius_right) * accel * RAD_S),
        )
    return v, om


@kernel
def across(p: Any, v: float, om: float) -> float:
    """Return vy [m/s] of a body that drives and turns so."""
    return p.side_slip * v * om - p.icr * om + p.misalign * v


@kernel
def rolled_aside(p: Any, wheel: Any) -> float:
    """Return the speed to the left [m/s] that mecanum wheels make, fl, rl, fr, rr in rpm."""
    left = p.radius_left * (wheel[1] - wheel[0])
    right = p.radius_right * (wheel[3] - wheel[2])
    return 0.25 * p.rollers * RAD_S * (left + right)


@kernel
def tyre_rates(
    p: Any, left: float, right: float, v: float, vy: float, om: float
) -> Any:
    """Return dv, dvy, dom of the body on four tyres (friction anisotropic, regularised).

    Each tyre pulls against its slip with ``mu N s / sqrt(s^2 + s0^2)``; the friction across the
    wheel is `tyre_ratio` times that along it. The centre of mass lies `tyre_offset` in front of
    the wheels' centre.
    """
    rim_l, rim_r = p.radius_left * left * RAD_S, -p.radius_right * right * RAD_S
    dv, dvy, dom = 0.0, 0.0, 0.0
    for k in range(4):
        front = 1.0 if k % 2 == 0 else -1.0
        side = 1.0 if k < 2 else -1.0
        ahead = front * 0.5 * WHEELBASE_M - p.tyre_offset
        aside = side * 0.5 * TRACK_M
        weight = GRAVITY * (0.25 + front * 0.5 * p.tyre_offset / WHEELBASE_M)
        along = v - om * aside - (rim_l if k < 2 else rim_r)
        across = p.tyre_ratio * (vy + om * ahead)
        pull = -GRIP * weight / math.sqrt(along**2 + across**2 + SLIP_FLOOR_M_S**2)
        fx, fy = pull * along, pull * across * p.tyre_ratio
        dv += fx
        dvy += fy
        dom += (ahead * fy - aside * fx) / GYRATION2_M2
    if p.tyre_inertia != 0.0:
        dv += om * vy
        dvy -= om * v
    return dv, dvy, dom
