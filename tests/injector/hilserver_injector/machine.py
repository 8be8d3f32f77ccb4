"""The machine in continuous time: 0.1 ms steps of Heun's method under a sampled controller."""

import math
from typing import Any

import numpy as np

from hilserver_injector.compiled import kernel
from hilserver_injector.parameters import LOAD, SHOWN, T2_S
from hilserver_injector.pilot import (
    LAST_YAW,
    MOVE,
    N_PILOT,
    SLEW,
    WANT_L,
    WANT_R,
    drive,
    towards,
)
from hilserver_injector.plane import RAD_S, across, kinematic, rolled_aside, tyre_rates

STEP_S = 1e-4
REST_RPM = 0.05
DENSE_STEPS = 10
N_DENSE = 8  # t, x, y, yaw (not wrapped), v, vy, om, share of time inside the region
N_ROW = 13  # sent x 4, speed x 4, duty x 4, battery
TURNS_RAD_S = 0.05


@kernel
def open_voltage(charge: float) -> float:
    """Return the cell pack's voltage [V] without load: flat, steep at both ends."""
    q = min(max(charge, 0.0), 1.0)
    return 19.0 + 2.2 * q + 1.9 * q**12 - 1.5 * math.exp(-25.0 * q)


@kernel
def _rate(
    p: Any, flat: Any, i: int, x: float, n: float, duty: float, gain: float
) -> float:
    """Return x' of the slow lag of wheel `i` for the duty [%] that its amplifier gives out."""
    u = duty
    if p.dead_zone != 0.0:
        u = math.copysign(max(abs(u) - p.dead_zone, 0.0), u)
    friction = p.coulomb + flat[LOAD + i]
    if p.stribeck != 0.0:
        friction += p.stribeck * math.exp(-((n / p.stribeck_rpm) ** 2))
    if friction != 0.0:
        if abs(n) >= REST_RPM:
            u -= math.copysign(friction, n)
        elif abs(u) <= friction:
            u = 0.0
        else:
            u -= math.copysign(friction, u)
    return (gain * (u - p.viscous * n) - x) / p.t1


@kernel
def _control(p: Any, aim: float, seen: float, memory: Any, i: int) -> float:
    """Run the sampled PI of wheel `i` once, with back-calculation; returns the duty [%]."""
    error = aim - seen
    wanted = p.kp * error + memory[i]
    duty = min(max(wanted, -p.limit), p.limit)
    memory[i] += p.control_s * (p.ki * error + p.tracking * (duty - wanted))
    return duty


@kernel
def _seen(p: Any, n: float, filtered: float, shown: float) -> float:
    speed = shown * (filtered if p.filter_s > 0.0 else n)
    if p.quantum > 0.0:
        speed = p.quantum * math.floor(speed / p.quantum + 0.5)
    return speed


@kernel
def _behind_play(p: Any, gap: Any, i: int, n: float) -> float:
    """Return the speed [rpm] of the wheel behind its play."""
    half = 0.5 * p.backlash
    gap[i] += n * RAD_S * STEP_S
    if gap[i] > half:
        gap[i] = half
        return n
    if gap[i] < -half:
        gap[i] = -half
        return n
    return 0.0


@kernel
def run(
    p_array: Any,
    flat: Any,
    first: Any,
    last: Any,
    course: Any,
    row_steps: Any,
    table: Any,
    moves: Any,
    lost: Any,
    stalled: Any,
    start: Any,
    rows: Any,
    dense: Any,
) -> None:
    """Run the machine over all rows of a log.

    Parameters
    ----------
    p_array, flat : one record of `RECORD`, and the same memory as float64
    first, last : ndarray, shape (n_p,)
        Constants when `course` is 0 and when it is 1.
    course : ndarray, shape (n,)
        Per row, for parameters that drift.
    row_steps : ndarray of int64, shape (n,)
        Instants of the rows in steps.
    table : ndarray, shape (n, 4) or (0, 4)
        Set-points [rpm]; none: the driver works off `moves`.
    lost, stalled : ndarray of bool, shape (n, 4) and (n,)
        Set-points that do not arrive; intervals in which the controller does not run.
    start : ndarray, shape (3,)
        Pose.
    rows, dense : ndarray, shape (n, N_ROW) and (m, N_DENSE)
        Results; `dense` every millisecond.
    """
    p = p_array[0]
    n_rows = row_steps.shape[0]
    flat[:] = first
    x, n, filtered, duty = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    integral, aim, goal, gap = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    slope, ahead_x, ahead_n, wheel = np.zeros(4), np.zeros(4), np.zeros(4), np.zeros(4)
    arrived = np.zeros((n_rows, 4))
    s = np.zeros(N_PILOT)
    px, py, yaw, angle = start[0], start[1], start[2], 0.0
    s[LAST_YAW] = yaw
    v, vy, om, memory, charge = 0.0, 0.0, 0.0, 1.0, p.charge
    next_control, k, taken, n_dense = 0.0, 0, -1, 0
    for step in range(row_steps[n_rows - 1] + 1):
        t = step * STEP_S
        at_row = step == row_steps[k]
        if at_row:
            for j in range(flat.shape[0]):
                flat[j] = first[j] + (last[j] - first[j]) * course[k]
            if table.shape[0] > 0:
                for i in range(4):
                    rows[k, i] = table[k, i]
            else:
                drive(s, moves, t, px, py, yaw)
                most = moves[int(s[MOVE]), SLEW] * 0.02
                now_l = rows[k - 1, 0] if k > 0 else 0.0
                now_r = -rows[k - 1, 2] if k > 0 else 0.0
                rows[k, 0] = rows[k, 1] = towards(now_l, s[WANT_L], most)
                rows[k, 2] = rows[k, 3] = -towards(now_r, s[WANT_R], most)
            for i in range(4):
                missed = lost[k, i] and k > 0
                arrived[k, i] = arrived[k - 1, i] if missed else rows[k, i]
        voltage = open_voltage(charge)
        current = 0.8
        for i in range(4):
            current += 0.015 * abs(duty[i])
        voltage -= 0.15 * current
        charge -= current * STEP_S / (3.0 * 3600.0)
        while taken + 1 <= k and row_steps[taken + 1] * STEP_S + p.delay_s <= t + 1e-9:
            if taken + 1 == k and not at_row:
                break
            taken += 1
            for i in range(4):
                goal[i] = arrived[taken, i]
        if t >= next_control - 1e-9:
            next_control += p.control_s
            if not stalled[k]:
                for i in range(4):
                    aim[i] = towards(aim[i], goal[i], p.rate * p.control_s)
                    seen = _seen(p, n[i], filtered[i], flat[SHOWN + i])
                    duty[i] = _control(p, aim[i], seen, integral, i)
        if at_row:
            for i in range(4):
                rows[k, 4 + i] = _seen(p, n[i], filtered[i], flat[SHOWN + i])
                rows[k, 8 + i] = duty[i]
            rows[k, 12] = voltage
            k = min(k + 1, n_rows - 1)
        if step % DENSE_STEPS == 0:
            dense[n_dense, 0], dense[n_dense, 1], dense[n_dense, 2] = t, px, py
            dense[n_dense, 3], dense[n_dense, 4], dense[n_dense, 5] = yaw, v, vy
            dense[n_dense, 6], dense[n_dense, 7] = om, angle
            n_dense += 1
        # --- the four drives, Heun ---------------------------------------------------------
        gain = p.gain
        if p.sag != 0.0:
            gain *= max(1.0 + p.sag * (voltage / 19.2 - 1.0), 0.0)
        extra = 0.0
        if p.wave_duty != 0.0:
            extra = p.wave_duty * math.sin(
                2.0 * math.pi * t / p.wave_period + p.wave_phase
            )
        for i in range(4):
            u = duty[i] + extra
            if p.talk != 0.0 and i == int(p.talk_to):
                u += p.talk * duty[int(p.talk_from)]
            slope[i] = _rate(p, flat, i, x[i], n[i], u, gain)
            n_slope = (x[i] - n[i]) / T2_S
            ahead_x[i] = x[i] + STEP_S * slope[i]
            ahead_n[i] = n[i] + STEP_S * n_slope
            after = _rate(p, flat, i, ahead_x[i], ahead_n[i], u, gain)
            x[i] += 0.5 * STEP_S * (slope[i] + after)
            n[i] += 0.5 * STEP_S * (n_slope + (ahead_x[i] - ahead_n[i]) / T2_S)
            if p.filter_s > 0.0:
                filtered[i] += (1.0 - math.exp(-STEP_S / p.filter_s)) * (
                    n[i] - filtered[i]
                )
            wheel[i] = n[i] if p.backlash == 0.0 else _behind_play(p, gap, i, n[i])
        left, right = 0.5 * (wheel[0] + wheel[1]), 0.5 * (wheel[2] + wheel[3])
        angle += left * RAD_S * STEP_S
        # --- the body: velocity at the end of the step, pose by the mean velocity ----------------
        v_was, vy_was, om_was = v, vy, om
        if p.tyres != 0.0:
            dv, dvy, dom = tyre_rates(p, left, right, v, vy + p.icr * om, om)
            v_on, vy_on, om_on = (
                v + STEP_S * dv,
                vy + p.icr * om + STEP_S * dvy,
                om + STEP_S * dom,
            )
            ev, evy, eom = tyre_rates(p, left, right, v_on, vy_on, om_on)
            lateral = vy + p.icr * om + 0.5 * STEP_S * (dvy + evy)
            v += 0.5 * STEP_S * (dv + ev)
            om += 0.5 * STEP_S * (dom + eom)
            vy = lateral - p.icr * om
        else:
            accel = 0.0
            if p.accel_slip != 0.0:
                accel = (
                    0.25
                    * (x[0] - n[0] + x[1] - n[1] - x[2] + n[2] - x[3] + n[3])
                    / T2_S
                )
            inside = p.x_min <= px <= p.x_max and p.y_min <= py <= p.y_max
            made_v, made_om = kinematic(p, left, right, accel, angle, inside)
            if p.lag_s > 0.0:
                follows = 1.0 - math.exp(-STEP_S / p.lag_s)
                v, om = v + follows * (made_v - v), om + follows * (made_om - om)
            else:
                v, om = made_v, made_om
            vy = across(p, v, om)
            if p.rollers != 0.0:
                vy += rolled_aside(p, wheel)
            if p.drag_turn != 0.0 or p.drag_speed != 0.0:
                pull = math.cos(yaw - p.drag_phase)
                om, v = om * (1.0 + p.drag_turn * pull), v * (1.0 + p.drag_speed * pull)
            if p.memory != 0.0:
                if abs(v) > 0.1:
                    memory = math.copysign(1.0, v)
                om *= 1.0 + p.memory * memory
        turning = (abs(left) + abs(right)) * RAD_S > TURNS_RAD_S
        if p.wave_turn != 0.0 and turning:
            om += p.wave_turn * math.sin(
                2.0 * math.pi * t / p.wave_period + p.wave_phase
            )
        mv, mvy, mom = 0.5 * (v + v_was), 0.5 * (vy + vy_was), 0.5 * (om + om_was)
        middle = yaw + 0.5 * mom * STEP_S
        c, d = math.cos(middle), math.sin(middle)
        px += STEP_S * (mv * c - mvy * d)
        py += STEP_S * (mv * d + mvy * c)
        yaw += STEP_S * mom
        if turning and (p.slope_x != 0.0 or p.slope_y != 0.0):
            px += STEP_S * p.slope_x
            py += STEP_S * p.slope_y
