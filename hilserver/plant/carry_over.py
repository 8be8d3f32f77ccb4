"""What the state becomes when parameters change: it jumps only where the change itself makes it.

Most states go on as they are: the integral is in units of the duty, so that another gain leaves it
alone. Here stand those that a term begins to use, or that have the old parameter in them. Equal
parameters change no bit.
"""

import math
from typing import Any

import hilserver.plant.layout as at
from hilserver.plant.drive import REST_RPM
from hilserver.plant.kernels import part
from hilserver.plant.kinematics import in_region, velocity_terms
from hilserver.plant.layout import Parameters
from hilserver.plant.robot import SIDE


@part
def _filtered(p: Parameters, x: Any, i: int) -> float:
    """Return what the encoder filter of wheel `i` would show now [rpm], before gain and steps."""
    if p.encoder_share == 1.0:
        return float(x[at.X_SPEED + i])
    return float(x[at.X_ENCODER + i] + p.encoder_share * x[at.X_SPEED + i])


@part
def _carry_wheel(old: Parameters, new: Parameters, x: Any, i: int) -> None:
    """Carry derivative, encoder filter and play of one wheel over."""
    filtered = _filtered(old, x, i)
    if old.derivative_gain == 0.0 and new.derivative_gain != 0.0:
        seen = filtered * new.encoder_gain[i]
        if new.quantum != 0.0:
            seen = new.quantum * math.floor(seen / new.quantum + 0.5)
        x[at.X_DERIVATIVE + i] = 0.0
        x[at.X_LAST_ERROR + i] = x[at.X_SETPOINT + i] - seen
    if old.encoder_share != new.encoder_share or old.encoder_keep != new.encoder_keep:
        x[at.X_ENCODER + i] = filtered - new.encoder_share * x[at.X_SPEED + i]
    if new.backlash != old.backlash:
        gap, speed = x[at.X_GAP + i], x[at.X_SPEED + i]
        if old.backlash == 0.0:  # the flank that drives is in contact
            gap = math.copysign(new.backlash, speed) if abs(speed) >= REST_RPM else 0.0
        elif abs(gap) >= old.backlash:
            gap = math.copysign(new.backlash, gap)
        else:
            gap *= new.backlash / old.backlash
        x[at.X_GAP + i] = gap


@part
def _fill_ring(x: Any) -> None:
    """Let the ring of set-points hold what the loops follow now: what was before is not known."""
    for row in range(at.RING):
        for i in range(at.N_WHEELS):
            x[at.X_SETPOINT_RING + at.N_WHEELS * row + i] = x[at.X_SETPOINT + i]


@part
def _catch_up(p: Parameters, x: Any) -> None:
    """Let a body that begins to lag have the speed and turn rate that its wheels give it now."""
    left, right = x[at.X_SPEED] + x[at.X_SPEED + 1], x[at.X_SPEED + 2] + x[at.X_SPEED + 3]
    faster_left = x[at.X_MOTOR] + x[at.X_MOTOR + 1] - left
    faster_right = x[at.X_MOTOR + 2] + x[at.X_MOTOR + 3] - right
    rate = SIDE * p.inverse_t2
    v, om, _, _ = velocity_terms(
        p,
        in_region(p, x),
        0.5 * (x[at.X_ANGLE] + x[at.X_ANGLE + 1]),
        left * SIDE,
        right * SIDE,
        faster_left * rate,
        faster_right * rate,
    )
    x[at.X_BODY], x[at.X_BODY + 1] = v, om


@part
def carry_over(old: Parameters, new: Parameters, x: Any) -> None:
    """Make the state `x` that of the new parameters, between two ticks."""
    if new.command_terms != 0.0 and old.command_terms == 0.0:
        _fill_ring(x)
    if new.drive_terms != 0.0 and old.drive_terms == 0.0:
        x[at.X_CONTROL_PHASE] = 0.0  # it was not counted: no duty is held
    x[at.X_CONTROL_PHASE] = min(x[at.X_CONTROL_PHASE], new.control_ticks)
    for i in range(at.N_WHEELS):
        _carry_wheel(old, new, x, i)
    if new.body_lag != 0.0 and old.body_lag == 0.0:
        _catch_up(old, x)
    if new.imu_delay != 0.0 and old.imu_delay == 0.0:
        x[at.X_IMU_COUNT] = 0.0
    x[at.X_NAV_WAIT] = min(x[at.X_NAV_WAIT], new.nav_every)
    for i in range(3):
        before, after = (old.nav_ou, new.nav_ou) if i < 2 else (old.nav_yaw_ou, new.nav_yaw_ou)
        if before == 0.0 and after != 0.0:
            x[at.X_NAV_OU + i] = 0.0
