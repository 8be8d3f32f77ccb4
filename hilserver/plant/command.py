"""Step 1 of the tick: from latched inputs to the set-points that the wheel loops follow."""

from typing import Any

import hilserver.plant.layout as at
from hilserver.plant.kernels import inlined, part
from hilserver.plant.layout import Parameters


@part
def safe_ramp(p: Parameters, x: Any) -> None:
    """Take the set-points linearly to zero, from what was commanded last."""
    if x[at.X_LAST_COMMAND] != at.COMMAND_SAFE:
        x[at.X_RAMP_TICKS] = 0.0
        for i in range(at.N_WHEELS):
            x[at.X_RAMP_START + i] = x[at.X_COMMANDED + i]
    x[at.X_RAMP_TICKS] += 1.0
    left = max(0.0, 1.0 - x[at.X_RAMP_TICKS] * p.ramp_step)
    for i in range(at.N_WHEELS):
        x[at.X_COMMANDED + i] = x[at.X_RAMP_START + i] * left


@part
def inverse_kinematics(
    p: Parameters, x: Any, linear_m_s: float, lateral_m_s: float, angular_rad_s: float
) -> None:
    """Set the wheels for a twist, equation (5.25), with nominal values.

    In exclusive mode (5.4) the larger of ``|v|`` and ``|om| l_y/2`` drives alone. The rollers of
    mecanum wheels form an X seen from above: to the left, the wheels of each side turn apart.
    """
    if p.exclusive != 0.0 and linear_m_s != 0.0 and angular_rad_s != 0.0:
        x[at.X_TWIST_REDUCED] = 1.0
        if abs(linear_m_s) >= abs(angular_rad_s) * p.half_track:
            angular_rad_s = 0.0
        else:
            linear_m_s = 0.0
    straight = linear_m_s * p.rpm_per_m_s
    turning = angular_rad_s * p.rpm_per_rad_s
    x[at.X_COMMANDED] = turning + straight
    x[at.X_COMMANDED + 1] = turning + straight
    x[at.X_COMMANDED + 2] = turning - straight
    x[at.X_COMMANDED + 3] = turning - straight
    if p.mecanum != 0.0:
        sideways = lateral_m_s * p.rpm_per_m_s
        x[at.X_COMMANDED] -= sideways
        x[at.X_COMMANDED + 1] += sideways
        x[at.X_COMMANDED + 2] -= sideways
        x[at.X_COMMANDED + 3] += sideways


@part
def direct_duty(x: Any, u: Any) -> None:
    """Drive with commanded duties; the speed loop follows, so that it can take over at any tick."""
    x[at.X_DIRECT] = 1.0
    for i in range(at.N_WHEELS):
        x[at.X_DUTY_COMMAND + i] = u[at.U_DUTY + i]
        x[at.X_COMMANDED + i] = x[at.X_SPEED + i]


@inlined
def limit_speed(p: Parameters, x: Any) -> None:
    """Scale all wheels together to at most max_rpm, so that the path keeps its shape."""
    largest = abs(x[at.X_COMMANDED])
    for i in range(1, at.N_WHEELS):
        largest = max(largest, abs(x[at.X_COMMANDED + i]))
    if largest > p.max_rpm:
        x[at.X_SCALED] = 1.0
        factor = p.max_rpm / largest
        for i in range(at.N_WHEELS):
            x[at.X_COMMANDED + i] *= factor


@part
def delay_and_rate(p: Parameters, x: Any) -> None:
    """Replace the set-points by those valid at t - tau, then limit their rate."""
    head = (int(x[at.X_SETPOINT_HEAD]) + 1) % at.RING
    x[at.X_SETPOINT_HEAD] = head
    old = (head - int(p.delay_ticks) + at.RING) % at.RING
    step = p.rate_step
    for i in range(at.N_WHEELS):
        x[at.X_SETPOINT_RING + 4 * head + i] = x[at.X_COMMANDED + i]
        wanted = x[at.X_SETPOINT_RING + 4 * old + i]
        last = x[at.X_SETPOINT + i]
        if wanted > last + step:
            wanted = last + step
        elif wanted < last - step:
            wanted = last - step
        x[at.X_SETPOINT + i] = wanted


@inlined
def command(p: Parameters, x: Any, u: Any) -> None:
    """Latch the inputs of this tick into ``x[X_SETPOINT:]``.

    A disabled drive and the zero command count as a command of zero: delay and rate limit act on
    them as on any other.
    """
    wish = u[at.U_COMMAND]
    x[at.X_TWIST_REDUCED] = 0.0
    x[at.X_SCALED] = 0.0
    x[at.X_DIRECT] = 0.0
    for i in range(3):
        x[at.X_GAINS + i] = u[at.U_GAINS + i]
    if wish == at.COMMAND_SAFE:
        safe_ramp(p, x)
    elif wish != at.COMMAND_NORMAL or u[at.U_ENABLE] == 0.0:
        for i in range(at.N_WHEELS):
            x[at.X_COMMANDED + i] = 0.0
    elif u[at.U_MODE] == at.MODE_DUTY:
        direct_duty(x, u)
    else:
        if u[at.U_MODE] == at.MODE_WHEELS:
            for i in range(at.N_WHEELS):
                x[at.X_COMMANDED + i] = u[at.U_SETPOINT + i]
        else:
            inverse_kinematics(
                p, x, u[at.U_TWIST_LINEAR], u[at.U_TWIST_LATERAL], u[at.U_TWIST_ANGULAR]
            )
        limit_speed(p, x)
    x[at.X_LAST_COMMAND] = wish
    if p.command_terms != 0.0:
        delay_and_rate(p, x)
    else:
        for i in range(at.N_WHEELS):
            x[at.X_SETPOINT + i] = x[at.X_COMMANDED + i]
