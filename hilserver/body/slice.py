"""The mechatronic model as parts of the compiled step: its own slice, and those that read it."""

import math
from typing import Any

from hilserver.body.layout import (
    MOTION,
    STATUS,
    Addresses,
    BodyMotion,
    Constants,
    Signals,
    SignalStatus,
)
from hilserver.body.step import advance, body_axes, place_body, to_body
from hilserver.body.wheels import vector
from hilserver.compiled import inlined, part
from hilserver.compiled.records import record_at
from hilserver.plant.imu import show_imu
from hilserver.plant.layout import (
    COMMAND_SAFE,
    Inputs,
    Outputs,
    Parameters,
    State,
    Status,
)
from hilserver.plant.nav import show_nav
from hilserver.plant.pose import wrap
from hilserver.plant.tof import FARTHEST_M, NEAREST_M, seen_by, show_ranges
from hilserver.plant.units import RAD_S_PER_RPM
from hilserver.scheduler.faults import BODY
from hilserver.status import BAD_OUT_OF_SERVICE, GOOD, UNCERTAIN

MIRROR = (1.0, 1.0, -1.0, -1.0)


@inlined
def _show_motion(b: BodyMotion, pose: Any, out: Signals) -> None:
    axes = body_axes(b.orientation)
    for i in range(3):
        out.position[i] = b.position[i]
        out.gyro[i] = b.turning[i]
        out.accel[i] = b.accel[i]
    ahead, left, up = axes
    out.roll = math.atan2(left[2], up[2])
    out.pitch = math.asin(min(max(-ahead[2], -1.0), 1.0))
    yaw = math.atan2(ahead[1], ahead[0])
    out.yaw = yaw
    velocity = to_body(axes, vector(b.velocity))
    out.linear, out.lateral = velocity[0], velocity[1]
    out.angular = b.turning[2]
    out.gap = math.hypot(b.position[0] - pose[0], b.position[1] - pose[1])
    out.gap_yaw = wrap(yaw - pose[2])
    out.bump = b.bump


@inlined
def _show_wheels(b: BodyMotion, out: Signals) -> None:
    for i in range(4):
        out.speed[i] = MIRROR[i] * b.speed[i] / RAD_S_PER_RPM
        out.normal[i] = b.normal[i]
        out.slip[i] = b.slip[i]
        out.torque[i] = MIRROR[i] * b.torque[i]


@inlined
def _show_ranges(
    b: BodyMotion, plant: Parameters, hall: Any, out: Signals, status: SignalStatus
) -> None:
    x, y, yaw = b.position[0], b.position[1], out.yaw
    for k in range(4):
        distance = seen_by(plant, hall, k, x, y, yaw)
        out.tof[k] = min(max(distance, NEAREST_M), FARTHEST_M)
        if distance > FARTHEST_M:
            status.tof[k] = UNCERTAIN


@part
def run_slice(
    p: Constants,
    numbers: Any,
    a: Addresses,
    plant: Parameters,
    x: State,
    u: Inputs,
    y: Outputs,
    hall: Any,
    out: Signals,
    codes: Any,
) -> int:
    """Show the body of t_k, then compute the next slice; return 0, or `faults.BODY`.

    Parameters
    ----------
    p, numbers, a
        Of the body, see `advance`.
    plant, x, u, y, hall
        The planar plant's parameters, state, inputs and outputs, after its step of this tick.
    out : Signals
        Outputs ``mech.*`` in the working frame.
    codes : ndarray of int64, shape (Signals.n_words,)
        Their OPC UA status codes.
    """
    b = record_at(numbers, 0, MOTION)
    if u.pose_request != b.pose_request:
        b.pose_request = u.pose_request
        place_body(p, numbers, u.pose[0], u.pose[1], u.pose[2])
    good = UNCERTAIN if u.command == COMMAND_SAFE else GOOD
    if b.failed != 0.0:
        good = BAD_OUT_OF_SERVICE
    for i in range(codes.shape[0]):
        codes[i] = good
    _show_motion(b, y.pose, out)
    _show_wheels(b, out)
    _show_ranges(b, plant, hall, out, record_at(codes, 0, STATUS))
    if b.failed != 0.0:
        return BODY
    for i in range(4):
        rpm_or_duty = x.motor[i] if p.torque != 0.0 else x.speed[i] * RAD_S_PER_RPM
        b.asked[i] = MIRROR[i] * rpm_or_duty
    b.wait = p.ticks
    if not advance(p, numbers, a):
        stand_still(numbers)
        return BODY
    return 0


@inlined
def stand_still(numbers: Any) -> None:
    """Stop a body whose numbers are no longer good; all that is shown stays finite."""
    for i in range(numbers.shape[0]):
        if not math.isfinite(numbers[i]):
            numbers[i] = 0.0
    b = record_at(numbers, 0, MOTION)
    for i in range(3):
        b.velocity[i] = b.turning[i] = 0.0
    for i in range(4):
        b.speed[i] = 0.0
    b.failed = 1.0


@inlined
def hand_over_wheels(b: BodyMotion, x: State) -> None:
    """Before the plant's tick, set the wheel speeds that the body computed a slice ago."""
    if b.wait > 0.0:
        b.wait -= 1.0
        if b.wait == 0.0:
            for i in range(4):
                x.speed[i] = MIRROR[i] * b.speed[i] / RAD_S_PER_RPM


@inlined
def body_imu(b: BodyMotion, p: Parameters, x: State, y: Outputs, q: Status) -> None:
    """Show what the inertial unit measures in the body, with its noise and errors."""
    ahead, _, _ = body_axes(b.orientation)
    yaw = math.atan2(ahead[1], ahead[0])
    show_imu(p, x, b.turning[2], yaw, b.accel[0], b.accel[1], y, q)


@inlined
def body_ranges(b: BodyMotion, p: Parameters, y: Outputs, q: Status, hall: Any) -> None:
    """Show the ranges from the body's place."""
    if p.tof_enabled == 0.0:
        for k in range(4):
            q.tof[k] = BAD_OUT_OF_SERVICE
        return
    ahead, _, _ = body_axes(b.orientation)
    yaw = math.atan2(ahead[1], ahead[0])
    show_ranges(p, hall, b.position[0], b.position[1], yaw, y, q)


@inlined
def body_nav(b: BodyMotion, p: Parameters, x: State, y: Outputs, q: Status) -> None:
    """Show the body's pose as the navigation tag measures it, with its age, noise and errors."""
    ahead, _, _ = body_axes(b.orientation)
    yaw = math.atan2(ahead[1], ahead[0])
    show_nav(p, x, b.position[0], b.position[1], yaw, y, q)
