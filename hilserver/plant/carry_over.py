"""Carries the state over when parameters change: it jumps only where the change makes it jump.

Most states stay as they are; the integral, for example, is in units of duty, so a new gain does not
affect it. Handled here are states that a term starts to use, and states that depend on the old
parameter. Equal parameters change no bit.
"""

import math

from hilserver.compiled import inlined, part
from hilserver.plant.drive import REST_RPM
from hilserver.plant.kinematics import in_region, velocity_terms
from hilserver.plant.layout import N_WHEELS, RING, Parameters, State
from hilserver.plant.robot import SIDE


@inlined
def _filtered(p: Parameters, x: State, i: int) -> float:
    """Return what the encoder filter of wheel `i` would show now [rpm], before gain and steps."""
    if p.encoder_share == 1.0:
        return float(x.speed[i])
    return float(x.encoder[i] + p.encoder_share * x.speed[i])


@inlined
def _carry_wheel(old: Parameters, new: Parameters, x: State, i: int) -> None:
    """Carry derivative, encoder filter and play of one wheel over."""
    filtered = _filtered(old, x, i)
    if old.derivative_gain == 0.0 and new.derivative_gain != 0.0:
        seen = filtered * new.encoder_gain[i]
        if new.quantum != 0.0:
            seen = new.quantum * math.floor(seen / new.quantum + 0.5)
        x.derivative[i] = 0.0
        x.last_error[i] = x.setpoint[i] - seen
    if old.encoder_share != new.encoder_share or old.encoder_keep != new.encoder_keep:
        x.encoder[i] = filtered - new.encoder_share * x.speed[i]
    if new.backlash != old.backlash:
        gap, speed = x.gap[i], x.speed[i]
        if old.backlash == 0.0:  # the driving flank is in contact
            gap = math.copysign(new.backlash, speed) if abs(speed) >= REST_RPM else 0.0
        elif abs(gap) >= old.backlash:
            gap = math.copysign(new.backlash, gap)
        else:
            gap *= new.backlash / old.backlash
        x.gap[i] = gap


@inlined
def _fill_ring(x: State) -> None:
    """Fill the ring of set-points with the present ones; earlier ones are not known."""
    for row in range(RING):
        for i in range(N_WHEELS):
            x.setpoint_ring[row, i] = x.setpoint[i]


@inlined
def _catch_up(p: Parameters, x: State) -> None:
    """Give a body that starts to lag the speed and turn rate that its wheels make now."""
    left, right = x.speed[0] + x.speed[1], x.speed[2] + x.speed[3]
    faster_left = x.motor[0] + x.motor[1] - left
    faster_right = x.motor[2] + x.motor[3] - right
    rate = SIDE * p.inverse_t2
    v, om, _, _ = velocity_terms(
        p,
        in_region(p, x.pose[0], x.pose[1]),
        0.5 * (x.angle[0] + x.angle[1]),
        left * SIDE,
        right * SIDE,
        faster_left * rate,
        faster_right * rate,
    )
    x.body_v, x.body_om = v, om


@part
def carry_over(old: Parameters, new: Parameters, x: State) -> None:
    """Adapt the state `x` to new parameters, between two ticks."""
    if new.command_terms != 0.0 and old.command_terms == 0.0:
        _fill_ring(x)
    if new.drive_terms != 0.0 and old.drive_terms == 0.0:
        x.control_phase = 0.0  # not counted until now: no duty is held
    x.control_phase = min(x.control_phase, new.control_ticks)
    for i in range(N_WHEELS):
        _carry_wheel(old, new, x, i)
    if new.body_lag != 0.0 and old.body_lag == 0.0:
        _catch_up(old, x)
    if new.imu_delay != 0.0 and old.imu_delay == 0.0:
        x.imu_count = 0.0
    x.nav_wait = min(x.nav_wait, new.nav_every)
    for i in range(3):
        before, after = (
            (old.nav_ou, new.nav_ou) if i < 2 else (old.nav_yaw_ou, new.nav_yaw_ou)
        )
        if before == 0.0 and after != 0.0:
            x.nav_ou[i] = 0.0
