"""Steps 2 to 6 of the tick: wheel speed loops and their process, in the order of the contract.

Both functions publish speed and duty of t_k, move the state to t_(k+1) and return six sums over the
two wheels of a side, in rpm and rpm/s: speed at t_k (left, right), mean speed over the tick, and
acceleration at t_k.
"""

import math

from hilserver.compiled import inlined, part, plain
from hilserver.plant.layout import N_WHEELS, Outputs, Parameters, State
from hilserver.plant.units import NOMINAL_V, RAD_S_PER_RPM

REST_RPM = 0.05

Sums = tuple[float, float, float, float, float, float]
Matrices = tuple[float, float, float, float, float, float]


@inlined
def drive_base(p: Parameters, x: State, y: Outputs) -> Sums:
    """Run the drive with all terms at null: controller every plant slice, exact joint solution."""
    if x.direct + x.own_gains != 0.0:
        return drive_terms(p, x, y)  # type: ignore[no-any-return]
    kp, ki_step = p.k_p, p.k_i_step
    anti_windup, limit = p.anti_windup_step, p.limit
    a00, a01, b0 = p.a00, p.a01, p.b0
    a10, a11, b1 = p.a10, p.a11, p.b1
    half_turn = p.dt * (0.5 * RAD_S_PER_RPM)
    left, right = x.speed[0] + x.speed[1], x.speed[2] + x.speed[3]
    accel_left = (x.motor[0] + x.motor[1] - left) * p.inverse_t2
    accel_right = (x.motor[2] + x.motor[3] - right) * p.inverse_t2
    for i in range(N_WHEELS):
        speed, motor, integral = x.speed[i], x.motor[i], x.integral[i]
        error = x.setpoint[i] - speed
        wanted = kp * error + integral
        duty = min(max(wanted, -limit), limit)
        speed_next = a10 * motor + a11 * speed + b1 * duty
        y.speed[i] = speed
        y.duty[i] = duty
        y.angle[i] = x.angle[i]
        x.integral[i] = integral + (ki_step * error + anti_windup * (duty - wanted))
        x.motor[i] = a00 * motor + a01 * speed + b0 * duty
        x.speed[i] = speed_next
        x.angle[i] += half_turn * (speed + speed_next)
    mean_left = 0.5 * (left + (x.speed[0] + x.speed[1]))
    mean_right = 0.5 * (right + (x.speed[2] + x.speed[3]))
    return left, right, mean_left, mean_right, accel_left, accel_right


@part
def encoder(p: Parameters, x: State, i: int) -> float:
    """Return the speed of wheel `i` [rpm] as the loop sees it (step 2).

    The filter is exact for a speed that changes linearly over a tick. With held speeds it would be
    half a tick early.
    """
    speed = float(x.speed[i])
    seen = speed
    if p.encoder_share != 1.0:
        seen = x.encoder[i] + p.encoder_share * speed
        rest = 1.0 - p.encoder_share - p.encoder_keep
        x.encoder[i] = p.encoder_keep * seen + rest * speed
    seen *= p.encoder_gain[i]
    if p.quantum != 0.0:
        seen = p.quantum * math.floor(seen / p.quantum + 0.5)
    return float(seen)


@inlined
def controller(p: Parameters, x: State, i: int, seen_rpm: float) -> None:
    """Run the PI(D) loop of wheel `i` once (step 3), with back-calculation; set the held duty."""
    kp, ki_step = p.k_p, p.k_i_step
    if x.own_gains != 0.0:
        kp, ki_step = x.k_p, x.k_i * p.control_ticks * p.dt
    error = x.setpoint[i] - seen_rpm
    wanted = kp * error + x.integral[i]
    if p.derivative_gain != 0.0:
        change = p.derivative_gain * (error - x.last_error[i])
        x.derivative[i] = p.derivative_keep * x.derivative[i] + change
        x.last_error[i] = error
        wanted += x.derivative[i]
    limit = p.limit
    duty = min(max(wanted, -limit), limit)
    x.integral[i] += ki_step * error + p.anti_windup_step * (duty - wanted)
    x.duty[i] = duty


@inlined
def pass_duty(p: Parameters, x: State, i: int) -> None:
    """Apply the commanded duty of wheel `i`; the state of the controller tracks it."""
    limit = p.limit
    duty = min(max(x.duty_command[i], -limit), limit)
    x.duty[i] = x.integral[i] = duty
    x.derivative[i] = x.last_error[i] = 0.0


@part
def load(p: Parameters, i: int, duty_pct: float, speed_rpm: float) -> float:
    """Return the duty [%] left for the process after dead zone and friction (steps 4, 5)."""
    if p.dead_zone != 0.0:
        duty_pct = math.copysign(max(abs(duty_pct) - p.dead_zone, 0.0), duty_pct)
    friction = p.coulomb + p.wheel_load[i]
    if p.stribeck != 0.0:
        ratio = speed_rpm / p.stribeck_speed
        friction += p.stribeck * math.exp(-ratio * ratio)
    if friction == 0.0:
        return duty_pct
    if abs(speed_rpm) >= REST_RPM:
        return float(duty_pct - math.copysign(friction, speed_rpm))
    if abs(duty_pct) <= friction:
        return 0.0
    return float(duty_pct - math.copysign(friction, duty_pct))


@plain
def process_matrices(
    gain: float, viscous: float, t1_s: float, t2_s: float, dt_s: float
) -> Matrices:
    """Return ``a00, a01, a10, a11, b0, b1`` of step 6 over one tick, exactly.

    The continuous process is ``T1 x' = G (u - b n) - x``, ``T2 n' = x - n`` with u held. Its joint
    solution needs only ``exp(mean T) cosh(d T)`` and ``exp(mean T) sinh(d T) / d`` with mean and
    half difference d of the poles; d may be 0 (T1 = T2) or imaginary (viscous load).
    """
    mean = -0.5 * (1.0 / t1_s + 1.0 / t2_s)
    half = 0.5 * (1.0 / t2_s - 1.0 / t1_s)
    square = half * half - gain * viscous / (t1_s * t2_s)
    if abs(square) * dt_s * dt_s < 1e-16:
        cosh = math.exp(mean * dt_s)
        sinh = cosh * dt_s
    elif square > 0.0:
        d = math.sqrt(square)
        low = math.exp((mean - d) * dt_s)
        high = math.exp((mean + d) * dt_s)
        cosh = 0.5 * (high + low)
        sinh = (
            low * math.expm1(2.0 * d * dt_s) / (2.0 * d)
            if d * dt_s < 1.0
            else (high - low) / (2.0 * d)
        )
    else:
        d = math.sqrt(-square)
        cosh = math.exp(mean * dt_s) * math.cos(d * dt_s)
        sinh = math.exp(mean * dt_s) * math.sin(d * dt_s) / d
    a00 = cosh + half * sinh
    a01 = -gain * viscous / t1_s * sinh
    a10 = sinh / t2_s
    a11 = cosh - half * sinh
    steady = gain / (1.0 + gain * viscous)
    return a00, a01, a10, a11, (1.0 - a00 - a01) * steady, (1.0 - a10 - a11) * steady


@part
def process_of_tick(p: Parameters, voltage_v: float) -> Matrices:
    """Return the process of this tick: battery_sag scales the gain, and with it the coupling."""
    sag = 1.0
    if p.sag != 0.0:
        sag = max(1.0 + p.sag * (voltage_v / NOMINAL_V - 1.0), 0.0)
    if sag == 1.0 or p.viscous == 0.0:
        return (p.a00, p.a01, p.a10, p.a11, p.b0 * sag, p.b1 * sag)
    if p.euler != 0.0:
        return (p.a00, p.a01 * sag, p.a10, p.a11, p.b0 * sag, p.b1)
    return process_matrices(  # type: ignore[no-any-return]
        p.gain * sag, p.viscous, p.t1, p.t2, p.dt
    )


@inlined
def through_backlash(
    p: Parameters, x: State, i: int, speed_rpm: float, mean_rpm: float
) -> tuple[float, float]:
    """Return the speeds [rpm] behind the play: at t_k and the mean over the tick.

    The motor moves freely inside the play; the wheel follows while a flank is in contact.
    """
    half = p.backlash
    gap = x.gap[i]
    engaged = (gap >= half and speed_rpm > 0.0) or (gap <= -half and speed_rpm < 0.0)
    turned = mean_rpm * RAD_S_PER_RPM * p.dt
    free = gap + turned
    x.gap[i] = min(max(free, -half), half)
    moved = free - x.gap[i]  # exactly 0 inside the play
    return speed_rpm if engaged else 0.0, moved / (RAD_S_PER_RPM * p.dt)


@part
def drive_terms(p: Parameters, x: State, y: Outputs) -> Sums:
    """Run the drive with its terms, in the order of the contract; a term at null adds nothing."""
    runs = x.control_phase <= 1e-9
    if runs:
        x.control_phase += p.control_ticks
    x.control_phase -= 1.0
    a00, a01, a10, a11, b0, b1 = process_of_tick(p, x.battery_v)
    half_turn = p.dt * (0.5 * RAD_S_PER_RPM)
    left, right, mean_left, mean_right, accel_left, accel_right = (
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
        0.0,
    )
    for i in range(N_WHEELS):
        speed, motor = x.speed[i], x.motor[i]
        seen = encoder(p, x, i)
        if x.direct != 0.0:
            pass_duty(p, x, i)
        elif runs:
            controller(p, x, i, seen)
        y.speed[i] = seen
        y.duty[i] = x.duty[i]
        y.angle[i] = x.angle[i]
        duty = load(p, i, x.duty[i], speed)
        if p.body_wheels != 0.0:  # the body model takes the duty and returns the speed
            x.motor[i] = duty * (b0 / p.b0)
            motor = speed
        else:
            x.motor[i] = a00 * motor + a01 * speed + b0 * duty
            x.speed[i] = a10 * motor + a11 * speed + b1 * duty
        x.angle[i] += half_turn * (speed + x.speed[i])
        mean = 0.5 * (speed + x.speed[i])
        accel = (motor - speed) * p.inverse_t2
        if p.backlash != 0.0:
            speed, mean = through_backlash(p, x, i, speed, mean)
            if speed == 0.0:
                accel = 0.0
        if i < 2:
            left, mean_left, accel_left = (
                left + speed,
                mean_left + mean,
                accel_left + accel,
            )
        else:
            right, mean_right, accel_right = (
                right + speed,
                mean_right + mean,
                accel_right + accel,
            )
    return left, right, mean_left, mean_right, accel_left, accel_right
