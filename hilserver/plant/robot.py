"""The robot: one tick of command, four wheel drives, kinematics and pose, compiled.

The order of the steps is the contract ("One tick" of the plant reference). At t_k the inputs are
latched and every output of t_k is written; then the state moves to t_(k+1).
"""

import math

from hilserver.compiled import inlined, part
from hilserver.plant.command import command
from hilserver.plant.drive import drive_base, drive_terms
from hilserver.plant.kinematics import (
    across,
    in_region,
    sideways,
    velocity_base,
    velocity_terms,
)
from hilserver.plant.layout import N_WHEELS, Inputs, Outputs, Parameters, State, Status
from hilserver.plant.pose import move, set_pose
from hilserver.plant.units import RAD_S_PER_RPM
from hilserver.status import BAD_NO_DATA, GOOD

SIDE = 0.5 * RAD_S_PER_RPM  # from the sum of two wheels in rpm to their mean in rad/s
SLOPE_REST_RAD_S = 0.05


@inlined
def publish(
    x: State, y: Outputs, v: float, vy: float, om: float, dv: float, dvy: float
) -> None:
    """Write the velocity of t_k, and the acceleration of the centre of mass for the IMU."""
    y.linear, y.lateral, y.angular = v, vy, om
    x.accel_x, x.accel_y = dv - om * vy, dvy + om * v


@inlined
def follow_wheels(
    p: Parameters,
    x: State,
    y: Outputs,
    w_l: float,
    w_r: float,
    dw_l: float,
    dw_r: float,
) -> None:
    """Set the body to the speed of its wheels [rad/s, rad/s2], without the lag of `body_lag`."""
    angle = 0.5 * (y.angle[0] + y.angle[1])
    v, om, _, _ = velocity_terms(
        p, in_region(p, x.pose[0], x.pose[1]), angle, w_l, w_r, dw_l, dw_r
    )
    x.body_v, x.body_om = v, om


@inlined
def lag_behind(
    x: State, v: float, om: float, lag_s: float, dt_s: float
) -> tuple[float, float]:
    """Move the body's v and om towards the wheels' over a tick; return their means.

    First-order lag, exact for wheels that keep the mean speed of the tick.
    """
    closed = -math.expm1(-dt_s / lag_s)
    behind_v, behind_om = x.body_v - v, x.body_om - om
    x.body_v -= closed * behind_v
    x.body_om -= closed * behind_om
    share = closed * lag_s / dt_s
    return v + share * behind_v, om + share * behind_om


@part
def drive_on_with_terms(
    p: Parameters,
    x: State,
    y: Outputs,
    w_l: float,
    w_r: float,
    dw_l: float,
    dw_r: float,
    mean_l: float,
    mean_r: float,
    aside: float,
    daside: float,
) -> None:
    """Publish and move as the base model does, with the kinematic terms (steps 8 to 11).

    Side speeds [rad/s] and their rates at t_k, the means over the tick, and the lateral speed of
    mecanum wheels at t_k with its rate. The means are used with wheel angle and acceleration at
    mid-tick.
    """
    dt, is_mecanum = p.dt, p.mecanum != 0.0
    inside = in_region(p, x.pose[0], x.pose[1])
    angle = 0.5 * (y.angle[0] + y.angle[1])
    v, om, dv, dom = velocity_terms(p, inside, angle, w_l, w_r, dw_l, dw_r)
    lag_s = p.body_lag
    if lag_s != 0.0:
        dv, dom = (v - x.body_v) / lag_s, (om - x.body_om) / lag_s
        v, om = x.body_v, x.body_om
    vy, dvy = across(p, v, om, dv, dom)
    if is_mecanum:
        vy, dvy = vy + aside, dvy + daside
    publish(x, y, v, vy, om, dv, dvy)
    angle = 0.5 * (angle + 0.5 * (x.angle[0] + x.angle[1]))
    dw_l, dw_r = (mean_l - w_l) * (2.0 / dt), (mean_r - w_r) * (2.0 / dt)
    v, om, _, _ = velocity_terms(p, inside, angle, mean_l, mean_r, dw_l, dw_r)
    if lag_s != 0.0:
        v, om = lag_behind(x, v, om, lag_s, dt)
    vy, _ = across(p, v, om, 0.0, 0.0)
    if is_mecanum:
        vy += 0.5 * (aside + sideways(p, x)[0])
    move(x, v, vy, om, dt)
    if abs(mean_l) + abs(mean_r) > SLOPE_REST_RAD_S:
        x.pose[0] += p.slope_x * dt
        x.pose[1] += p.slope_y * dt


@part
def robot_step(p: Parameters, x: State, u: Inputs, y: Outputs, q: Status) -> None:
    """Write the outputs of t_k and move the state to t_(k+1)."""
    set_pose(x, u)
    command(p, x, u)
    for i in range(N_WHEELS):
        q.speed[i] = q.duty[i] = q.angle[i] = GOOD
        y.demand[i] = x.setpoint[i]
        # of duties no speed is demanded: there the loop only tracks what the wheel does
        q.demand[i] = GOOD if x.direct == 0.0 else BAD_NO_DATA
    q.pose[0] = q.pose[1] = q.pose[2] = q.linear = q.lateral = q.angular = GOOD
    for i in range(3):
        y.pose[i] = x.pose[i]
    aside, daside = 0.0, 0.0
    if p.mecanum != 0.0:
        aside, daside = sideways(p, x)
    if p.drive_terms != 0.0:
        left, right, mean_left, mean_right, dleft, dright = drive_terms(p, x, y)
    else:
        left, right, mean_left, mean_right, dleft, dright = drive_base(p, x, y)
    w_l, w_r, dw_l, dw_r = left * SIDE, right * SIDE, dleft * SIDE, dright * SIDE
    mean_l, mean_r = mean_left * SIDE, mean_right * SIDE
    if p.kinematic_terms != 0.0:
        drive_on_with_terms(
            p, x, y, w_l, w_r, dw_l, dw_r, mean_l, mean_r, aside, daside
        )
        return
    v, vy, om, dv, dvy, _ = velocity_base(p, w_l, w_r, dw_l, dw_r)
    publish(x, y, v, vy, om, dv, dvy)
    v, vy, om, _, _, _ = velocity_base(p, mean_l, mean_r, 0.0, 0.0)
    move(x, v, vy, om, p.dt)
