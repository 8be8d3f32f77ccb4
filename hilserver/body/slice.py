"""The mechatronic model as parts of the compiled step: its own slice, and who asks it."""

import math
from typing import Any

import hilserver.body.layout as at
from hilserver.body.step import advance, body_axes, place_body, to_body
from hilserver.body.wheels import vector
from hilserver.plant.imu import show_imu
from hilserver.plant.kernels import part
from hilserver.plant.layout import (
    BAD_OUT_OF_SERVICE,
    COMMAND_SAFE,
    GOOD,
    UNCERTAIN,
    Inputs,
    Outputs,
    Parameters,
    State,
    Status,
)
from hilserver.plant.pose import wrap
from hilserver.plant.tof import FARTHEST_M, NEAREST_M, seen_by, show_ranges
from hilserver.plant.units import RAD_S_PER_RPM
from hilserver.scheduler.faults import BODY

MIRROR = (1.0, 1.0, -1.0, -1.0)


@part
def _show_motion(b: Any, pose: Any, out: Any) -> None:
    axes = body_axes(b, at.B_QPOS + 3)
    for i in range(3):
        out[at.M_POSITION + i] = b[at.B_QPOS + i]
        out[at.M_GYRO + i] = b[at.B_QVEL + 3 + i]
        out[at.M_ACCEL + i] = b[at.B_ACCEL + i]
    ahead, left, up = axes
    out[at.M_ANGLES] = math.atan2(left[2], up[2])
    out[at.M_ANGLES + 1] = math.asin(min(max(-ahead[2], -1.0), 1.0))
    yaw = math.atan2(ahead[1], ahead[0])
    out[at.M_ANGLES + 2] = yaw
    velocity = to_body(axes, vector(b, at.B_QVEL))
    out[at.M_VELOCITY], out[at.M_VELOCITY + 1] = velocity[0], velocity[1]
    out[at.M_VELOCITY + 2] = b[at.B_QVEL + 5]
    out[at.M_GAP] = math.hypot(b[at.B_QPOS] - pose[0], b[at.B_QPOS + 1] - pose[1])
    out[at.M_GAP + 1] = wrap(yaw - pose[2])


@part
def _show_wheels(b: Any, out: Any) -> None:
    for i in range(4):
        out[at.M_SPEED + i] = MIRROR[i] * b[at.B_SPEED + i] / RAD_S_PER_RPM
        out[at.M_NORMAL + i] = b[at.B_NORMAL + i]
        out[at.M_SLIP + i] = b[at.B_SLIP + i]
        out[at.M_TORQUE + i] = MIRROR[i] * b[at.B_TORQUE + i]


@part
def _show_ranges(b: Any, plant: Parameters, hall: Any, out: Any, status: Any) -> None:
    x, y, yaw = b[at.B_QPOS], b[at.B_QPOS + 1], out[at.M_ANGLES + 2]
    for k in range(4):
        distance = seen_by(plant, hall, k, x, y, yaw)
        out[at.M_TOF + k] = min(max(distance, NEAREST_M), FARTHEST_M)
        if distance > FARTHEST_M:
            status[at.M_TOF + k] = UNCERTAIN


@part
def run_slice(
    p: Any,
    b: Any,
    a: Any,
    plant: Parameters,
    x: State,
    u: Inputs,
    y: Outputs,
    hall: Any,
    out: Any,
    status: Any,
) -> int:
    """Show the body of t_k, then compute the next slice; return 0, or `faults.BODY`.

    Parameters
    ----------
    p, b, a : ndarray
        Of the body, see `hilserver.body.layout`.
    plant, x, u, y, hall
        The planar plant's parameters, state, inputs and outputs, after its step of this tick.
    out : ndarray of float64, shape (N_M,)
        Outputs ``mech.*`` in the working frame.
    status : ndarray of int64, shape (N_M,)
        Their OPC UA status codes.
    """
    if u.pose_request != b[at.B_POSE_REQUEST]:
        b[at.B_POSE_REQUEST] = u.pose_request
        place_body(p, b, u.pose[0], u.pose[1], u.pose[2])
    good = UNCERTAIN if u.command == COMMAND_SAFE else GOOD
    if b[at.B_FAILED] != 0.0:
        good = BAD_OUT_OF_SERVICE
    for i in range(at.N_M):
        status[i] = good
    _show_motion(b, y.pose, out)
    _show_wheels(b, out)
    _show_ranges(b, plant, hall, out, status)
    if b[at.B_FAILED] != 0.0:
        return BODY
    for i in range(4):
        rpm_or_duty = x.motor[i] if p[at.P_TORQUE] != 0.0 else x.speed[i] * RAD_S_PER_RPM
        b[at.B_ASKED + i] = MIRROR[i] * rpm_or_duty
    b[at.B_WAIT] = p[at.P_TICKS]
    if not advance(p, b, a):
        stand_still(b)
        return BODY
    return 0


@part
def stand_still(b: Any) -> None:
    """Give a body up whose numbers are no longer good: all that is shown stays finite."""
    for i in range(b.shape[0]):
        if not math.isfinite(b[i]):
            b[i] = 0.0
    for i in range(6):
        b[at.B_QVEL + i] = 0.0
    for i in range(4):
        b[at.B_SPEED + i] = 0.0
    b[at.B_FAILED] = 1.0


@part
def hand_over_wheels(b: Any, x: State) -> None:
    """Before the plant's tick: let the wheels turn as the body computed a slice ago."""
    if b[at.B_WAIT] > 0.0:
        b[at.B_WAIT] -= 1.0
        if b[at.B_WAIT] == 0.0:
            for i in range(4):
                x.speed[i] = MIRROR[i] * b[at.B_SPEED + i] / RAD_S_PER_RPM


@part
def body_imu(b: Any, p: Parameters, x: State, y: Outputs, q: Status) -> None:
    """Show what the inertial unit measures in the body, with its noise and errors."""
    ahead, _, _ = body_axes(b, at.B_QPOS + 3)
    yaw = math.atan2(ahead[1], ahead[0])
    show_imu(p, x, b[at.B_QVEL + 5], yaw, b[at.B_ACCEL], b[at.B_ACCEL + 1], y, q)


@part
def body_ranges(b: Any, p: Parameters, y: Outputs, q: Status, hall: Any) -> None:
    """Show the ranges from where the body is."""
    if p.tof_enabled == 0.0:
        for k in range(4):
            q.tof[k] = BAD_OUT_OF_SERVICE
        return
    ahead, _, _ = body_axes(b, at.B_QPOS + 3)
    yaw = math.atan2(ahead[1], ahead[0])
    show_ranges(p, hall, b[at.B_QPOS], b[at.B_QPOS + 1], yaw, y, q)
