"""Step 1 of the tick: from latched inputs to the set-points that the wheel loops follow."""

from hilserver.compiled import inlined
from hilserver.plant.layout import (
    COMMAND_NORMAL,
    COMMAND_SAFE,
    MODE_DUTY,
    MODE_WHEELS,
    N_WHEELS,
    RING,
    Inputs,
    Parameters,
    State,
)


@inlined
def safe_ramp(p: Parameters, x: State) -> None:
    """Ramp the set-points linearly to zero from the last command."""
    if x.last_command != COMMAND_SAFE:
        x.ramp_ticks = 0.0
        for i in range(N_WHEELS):
            x.ramp_start[i] = x.commanded[i]
    x.ramp_ticks += 1.0
    left = max(0.0, 1.0 - x.ramp_ticks * p.ramp_step)
    for i in range(N_WHEELS):
        x.commanded[i] = x.ramp_start[i] * left


@inlined
def inverse_kinematics(
    p: Parameters, x: State, linear_m_s: float, lateral_m_s: float, angular_rad_s: float
) -> None:
    """Set the wheel speeds for a twist, equation (5.25), with nominal values.

    In exclusive mode (5.4) the larger of ``|v|`` and ``|om| l_y/2`` drives alone. The rollers of
    mecanum wheels form an X seen from above: to move left, the wheels of each side turn apart.
    """
    if p.exclusive != 0.0 and linear_m_s != 0.0 and angular_rad_s != 0.0:
        x.twist_reduced = 1.0
        if abs(linear_m_s) >= abs(angular_rad_s) * p.half_track:
            angular_rad_s = 0.0
        else:
            linear_m_s = 0.0
    straight = linear_m_s * p.rpm_per_m_s
    turning = angular_rad_s * p.rpm_per_rad_s
    x.commanded[0] = turning + straight
    x.commanded[1] = turning + straight
    x.commanded[2] = turning - straight
    x.commanded[3] = turning - straight
    if p.mecanum != 0.0:
        sideways = lateral_m_s * p.rpm_per_m_s
        x.commanded[0] -= sideways
        x.commanded[1] += sideways
        x.commanded[2] -= sideways
        x.commanded[3] += sideways


@inlined
def direct_duty(x: State, u: Inputs) -> None:
    """Drive with commanded duties; the speed loop tracks them, so it can take over at any tick."""
    x.direct = 1.0
    for i in range(N_WHEELS):
        x.duty_command[i] = u.duty[i]
        x.commanded[i] = x.speed[i]


@inlined
def limit_speed(p: Parameters, x: State) -> None:
    """Scale all wheels together down to max_rpm, so that the path keeps its shape."""
    largest = abs(x.commanded[0])
    for i in range(1, N_WHEELS):
        largest = max(largest, abs(x.commanded[i]))
    if largest > p.max_rpm:
        x.scaled = 1.0
        factor = p.max_rpm / largest
        for i in range(N_WHEELS):
            x.commanded[i] *= factor


@inlined
def delay_and_rate(p: Parameters, x: State) -> None:
    """Replace the set-points by those valid at t - tau, then limit their rate."""
    head = (int(x.setpoint_head) + 1) % RING
    x.setpoint_head = head
    old = (head - int(p.delay_ticks) + RING) % RING
    step = p.rate_step
    for i in range(N_WHEELS):
        x.setpoint_ring[head, i] = x.commanded[i]
        wanted = x.setpoint_ring[old, i]
        last = x.setpoint[i]
        if wanted > last + step:
            wanted = last + step
        elif wanted < last - step:
            wanted = last - step
        x.setpoint[i] = wanted


@inlined
def command(p: Parameters, x: State, u: Inputs) -> None:
    """Latch the inputs of this tick into ``x.setpoint``.

    A disabled drive and the zero command count as a command of zero, to which delay and rate limit
    apply as to any other.
    """
    wish = u.command
    x.twist_reduced = 0.0
    x.scaled = 0.0
    x.direct = 0.0
    x.own_gains, x.k_p, x.k_i = u.own_gains, u.k_p, u.k_i
    if wish == COMMAND_SAFE:
        safe_ramp(p, x)
    elif wish != COMMAND_NORMAL or u.enable == 0.0:
        for i in range(N_WHEELS):
            x.commanded[i] = 0.0
    elif u.mode == MODE_DUTY:
        direct_duty(x, u)
    else:
        if u.mode == MODE_WHEELS:
            for i in range(N_WHEELS):
                x.commanded[i] = u.setpoint[i]
        else:
            inverse_kinematics(p, x, u.twist_linear, u.twist_lateral, u.twist_angular)
        limit_speed(p, x)
    x.last_command = wish
    if p.command_terms != 0.0:
        delay_and_rate(p, x)
    else:
        for i in range(N_WHEELS):
            x.setpoint[i] = x.commanded[i]
