"""Step 1 of the tick: from latched inputs to the set-points that the wheel loops follow."""

from typing import Any

from hilserver.plant.kernels import inlined, part
from hilserver.plant.layout import (
    COMMAND_NORMAL,
    COMMAND_SAFE,
    MODE_DUTY,
    MODE_WHEELS,
    N_WHEELS,
    P_COMMAND_TERMS,
    P_DELAY_TICKS,
    P_EXCLUSIVE,
    P_HALF_TRACK,
    P_MAX_RPM,
    P_MECANUM,
    P_RAMP_STEP,
    P_RATE_STEP,
    P_RPM_PER_M_S,
    P_RPM_PER_RAD_S,
    RING,
    U_COMMAND,
    U_DUTY,
    U_ENABLE,
    U_GAINS,
    U_MODE,
    U_SETPOINT,
    U_TWIST_ANGULAR,
    U_TWIST_LATERAL,
    U_TWIST_LINEAR,
    X_COMMANDED,
    X_DIRECT,
    X_DUTY_COMMAND,
    X_GAINS,
    X_LAST_COMMAND,
    X_RAMP_START,
    X_RAMP_TICKS,
    X_SCALED,
    X_SETPOINT,
    X_SETPOINT_HEAD,
    X_SETPOINT_RING,
    X_SPEED,
    X_TWIST_REDUCED,
)


@part
def safe_ramp(p: Any, x: Any) -> None:
    """Take the set-points linearly to zero, from what was commanded last."""
    if x[X_LAST_COMMAND] != COMMAND_SAFE:
        x[X_RAMP_TICKS] = 0.0
        for i in range(N_WHEELS):
            x[X_RAMP_START + i] = x[X_COMMANDED + i]
    x[X_RAMP_TICKS] += 1.0
    left = max(0.0, 1.0 - x[X_RAMP_TICKS] * p[P_RAMP_STEP])
    for i in range(N_WHEELS):
        x[X_COMMANDED + i] = x[X_RAMP_START + i] * left


@part
def inverse_kinematics(
    p: Any, x: Any, linear_m_s: float, lateral_m_s: float, angular_rad_s: float
) -> None:
    """Set the wheels for a twist, equation (5.25), with nominal values.

    In exclusive mode (5.4) the larger of ``|v|`` and ``|om| l_y/2`` drives alone. The rollers of
    mecanum wheels form an X seen from above: to the left, the wheels of each side turn apart.
    """
    if p[P_EXCLUSIVE] != 0.0 and linear_m_s != 0.0 and angular_rad_s != 0.0:
        x[X_TWIST_REDUCED] = 1.0
        if abs(linear_m_s) >= abs(angular_rad_s) * p[P_HALF_TRACK]:
            angular_rad_s = 0.0
        else:
            linear_m_s = 0.0
    straight = linear_m_s * p[P_RPM_PER_M_S]
    turning = angular_rad_s * p[P_RPM_PER_RAD_S]
    x[X_COMMANDED] = turning + straight
    x[X_COMMANDED + 1] = turning + straight
    x[X_COMMANDED + 2] = turning - straight
    x[X_COMMANDED + 3] = turning - straight
    if p[P_MECANUM] != 0.0:
        sideways = lateral_m_s * p[P_RPM_PER_M_S]
        x[X_COMMANDED] -= sideways
        x[X_COMMANDED + 1] += sideways
        x[X_COMMANDED + 2] -= sideways
        x[X_COMMANDED + 3] += sideways


@part
def direct_duty(x: Any, u: Any) -> None:
    """Drive with commanded duties; the speed loop follows, so that it can take over at any tick."""
    x[X_DIRECT] = 1.0
    for i in range(N_WHEELS):
        x[X_DUTY_COMMAND + i] = u[U_DUTY + i]
        x[X_COMMANDED + i] = x[X_SPEED + i]


@inlined
def limit_speed(p: Any, x: Any) -> None:
    """Scale all wheels together to at most max_rpm, so that the path keeps its shape."""
    largest = abs(x[X_COMMANDED])
    for i in range(1, N_WHEELS):
        largest = max(largest, abs(x[X_COMMANDED + i]))
    if largest > p[P_MAX_RPM]:
        x[X_SCALED] = 1.0
        factor = p[P_MAX_RPM] / largest
        for i in range(N_WHEELS):
            x[X_COMMANDED + i] *= factor


@part
def delay_and_rate(p: Any, x: Any) -> None:
    """Replace the set-points by those valid at t - tau, then limit their rate."""
    head = (int(x[X_SETPOINT_HEAD]) + 1) % RING
    x[X_SETPOINT_HEAD] = head
    old = (head - int(p[P_DELAY_TICKS]) + RING) % RING
    step = p[P_RATE_STEP]
    for i in range(N_WHEELS):
        x[X_SETPOINT_RING + 4 * head + i] = x[X_COMMANDED + i]
        wanted = x[X_SETPOINT_RING + 4 * old + i]
        last = x[X_SETPOINT + i]
        if wanted > last + step:
            wanted = last + step
        elif wanted < last - step:
            wanted = last - step
        x[X_SETPOINT + i] = wanted


@inlined
def command(p: Any, x: Any, u: Any) -> None:
    """Latch the inputs of this tick into ``x[X_SETPOINT:]``.

    A disabled drive and the zero command count as a command of zero: delay and rate limit act on
    them as on any other.
    """
    wish = u[U_COMMAND]
    x[X_TWIST_REDUCED] = 0.0
    x[X_SCALED] = 0.0
    x[X_DIRECT] = 0.0
    for i in range(3):
        x[X_GAINS + i] = u[U_GAINS + i]
    if wish == COMMAND_SAFE:
        safe_ramp(p, x)
    elif wish != COMMAND_NORMAL or u[U_ENABLE] == 0.0:
        for i in range(N_WHEELS):
            x[X_COMMANDED + i] = 0.0
    elif u[U_MODE] == MODE_DUTY:
        direct_duty(x, u)
    else:
        if u[U_MODE] == MODE_WHEELS:
            for i in range(N_WHEELS):
                x[X_COMMANDED + i] = u[U_SETPOINT + i]
        else:
            inverse_kinematics(p, x, u[U_TWIST_LINEAR], u[U_TWIST_LATERAL], u[U_TWIST_ANGULAR])
        limit_speed(p, x)
    x[X_LAST_COMMAND] = wish
    if p[P_COMMAND_TERMS] != 0.0:
        delay_and_rate(p, x)
    else:
        for i in range(N_WHEELS):
            x[X_SETPOINT + i] = x[X_COMMANDED + i]
