"""The base model alone, written and compiled apart from the plant: no term, no switch.

It reads the same packed parameters and the same state, in the order of operations of the contract,
so that a term at null can be compared with it bit by bit.
"""

import math

import numba

RPM = 2.0 * math.pi / 60.0


@numba.njit(error_model="numpy")
def base_step(p, x, u, y):
    largest = 0.0
    for i in range(4):
        x.commanded[i] = u.setpoint[i]
        largest = max(largest, abs(x.commanded[i]))
    if largest > p.max_rpm:
        scale = p.max_rpm / largest
        for i in range(4):
            x.commanded[i] *= scale
    sums = [0.0, 0.0, 0.0, 0.0]
    nexts = [0.0, 0.0, 0.0, 0.0]
    motors = [0.0, 0.0, 0.0, 0.0]
    for i in range(4):
        n, m = x.speed[i], x.motor[i]
        sums[i], motors[i] = n, m
        y.speed[i] = n
        y.angle[i] = x.angle[i]
        y.demand[i] = x.commanded[i]
        e = x.commanded[i] - n
        w = p.k_p * e + x.integral[i]
        duty = w
        if duty < -p.limit:
            duty = -p.limit
        if duty > p.limit:
            duty = p.limit
        y.duty[i] = duty
        step = p.k_i_step * e + p.anti_windup_step * (duty - w)
        x.integral[i] = x.integral[i] + step
        x.motor[i] = p.a00 * m + p.a01 * n + p.b0 * duty
        x.speed[i] = p.a10 * m + p.a11 * n + p.b1 * duty
        nexts[i] = x.speed[i]
        x.angle[i] += p.dt * (0.5 * RPM) * (n + nexts[i])
    side = 0.5 * RPM
    left, right = sums[0] + sums[1], sums[2] + sums[3]
    w_l, w_r = left * side, right * side
    dw_l = (motors[0] + motors[1] - left) * p.inverse_t2 * side
    dw_r = (motors[2] + motors[3] - right) * p.inverse_t2 * side
    mean_l = 0.5 * (left + (nexts[0] + nexts[1])) * side
    mean_r = 0.5 * (right + (nexts[2] + nexts[3])) * side
    r_l, r_r = p.radius_left, p.radius_right
    om = p.yaw_gain * (r_l * w_l + r_r * w_r)
    v, vy = 0.5 * (r_l * w_l - r_r * w_r), -p.icr * om
    dom = p.yaw_gain * (r_l * dw_l + r_r * dw_r)
    dv, dvy = 0.5 * (r_l * dw_l - r_r * dw_r), -p.icr * dom
    y.linear, y.lateral, y.angular = v, vy, om
    x.accel_x, x.accel_y = dv - om * vy, dvy + om * v
    for i in range(3):
        y.pose[i] = x.pose[i]
    om = p.yaw_gain * (r_l * mean_l + r_r * mean_r)
    v, vy = 0.5 * (r_l * mean_l - r_r * mean_r), -p.icr * om
    half = 0.5 * om * p.dt
    chord = p.dt
    if abs(half) < 0.05:
        h2 = half * half
        chord *= 1.0 - h2 * (1.0 / 6.0 - h2 * (1.0 / 120.0 - h2 * (1.0 / 5040.0)))
    else:
        chord *= math.sin(half) / half
    heading = x.pose[2] + half
    cos, sin = math.cos(heading), math.sin(heading)
    x.pose[0] += chord * (v * cos - vy * sin)
    x.pose[1] += chord * (v * sin + vy * cos)
    heading += half
    if heading > math.pi:
        heading -= 2.0 * math.pi
    elif heading <= -math.pi:
        heading += 2.0 * math.pi
    x.pose[2] = heading
