"""A run of the mechatronic model: show what the last run computed, then compute the next slice.

What is computed at tick k is shown, and acts, exactly one slice later.
"""

import math
from typing import Any

from hilserver.body.layout import (
    MOTION,
    MUJOCO,
    N_WARNINGS,
    Addresses,
    BodyMotion,
    Constants,
)
from hilserver.body.wheels import Vector, dot, turn_wheels, vector
from hilserver.compiled import inlined, part
from hilserver.compiled.foreign import call
from hilserver.compiled.records import record_at

POSE_REQUEST = BodyMotion.where("pose_request").start
TOUCH = BodyMotion.where("touch").start
END = BodyMotion.n_words
GRAZING_SQUARED = 0.01
"""Squared share of a contact's normal in the wheel's plane below which no tyre force acts."""


@part
def body_axes(q: Any) -> tuple[Vector, Vector, Vector]:
    """Return the body's axes in the world's frame, from a unit quaternion."""
    w, x, y, z = q[0], q[1], q[2], q[3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@inlined
def to_body(axes: tuple[Vector, Vector, Vector], v: Vector) -> Vector:
    """Return a vector of the world in the body's frame."""
    return dot(axes[0], v), dot(axes[1], v), dot(axes[2], v)


@part
def to_world(axes: tuple[Vector, Vector, Vector], v: Vector) -> Vector:
    """Return a vector of the body in the world's frame."""
    a, b, c = axes
    return (
        a[0] * v[0] + b[0] * v[1] + c[0] * v[2],
        a[1] * v[0] + b[1] * v[1] + c[1] * v[2],
        a[2] * v[0] + b[2] * v[1] + c[2] * v[2],
    )


@inlined
def _push(p: Constants, b: BodyMotion, push: Any) -> None:
    """Step the wheels and apply their forces, and the drag, to MuJoCo's next step."""
    axes = body_axes(b.orientation)
    velocity, turning = to_body(axes, vector(b.velocity)), vector(b.turning)
    force, moment = turn_wheels(p, b, velocity, turning)
    drag = p.air * math.sqrt(dot(velocity, velocity))
    force = (
        force[0] - drag * velocity[0],
        force[1] - drag * velocity[1],
        force[2] - drag * velocity[2],
    )
    force, moment = to_world(axes, force), to_world(axes, moment)
    for i in range(3):
        push[i], push[3 + i] = force[i], moment[i]


@inlined
def _read_contacts(
    b: BodyMotion, place: Vector, axes: tuple[Vector, Vector, Vector]
) -> None:
    """Store normal force, point and direction of every wheel's contact, in the body's frame.

    `place` and `axes` are those before the step, for which the sensors were computed.
    """
    for i in range(4):
        up, where = to_body(axes, vector(b.touch[i, 0])), vector(b.touch[i, 1])
        size = math.sqrt(dot(up, up))
        sign = 1.0 if up[2] >= 0.0 else -1.0
        b.normal[i] = (
            size
            if up[0] * up[0] + up[2] * up[2] > GRAZING_SQUARED * size * size
            else 0.0
        )
        if b.normal[i] == 0.0:
            continue
        where = to_body(
            axes, (where[0] - place[0], where[1] - place[1], where[2] - place[2])
        )
        for k in range(3):
            b.up[i, k] = sign * up[k] / size
            b.contact[i, k] = where[k]


@inlined
def _is_finite(numbers: Any) -> bool:
    total = 0.0
    for i in range(END):
        total += abs(numbers[i])
    return math.isfinite(total)


@inlined
def place_body(p: Constants, numbers: Any, x: float, y: float, yaw: float) -> None:
    """Place the body at rest on the floor; its inputs and MuJoCo's time stay."""
    for i in range(POSE_REQUEST):
        numbers[i] = 0.0
    for i in range(MUJOCO + 1, numbers.shape[0]):
        numbers[i] = 0.0
    b = record_at(numbers, 0, MOTION)
    b.failed = 0.0
    b.position[0], b.position[1], b.position[2] = x, y, p.rest_height
    b.orientation[0], b.orientation[3] = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    b.accel[2] = 9.81


@part
def advance(p: Constants, numbers: Any, a: Addresses) -> bool:
    """Compute one slice, driven by `BodyMotion.asked`; return whether the state is still good.

    Parameters
    ----------
    numbers : ndarray of float64
        State, changed in place; MuJoCo's whole state is set from it and read back.
    """
    b = record_at(numbers, 0, MOTION)
    state, sensors, counters = (
        numbers[MUJOCO:],
        numbers[TOUCH:].ctypes.data,
        b.warnings.ctypes.data,
    )
    push = state[a.push :]
    for i in range(N_WARNINGS):
        b.warnings[i] = 0.0
    call(a.copy_bytes, a.warnings, counters, 8 * N_WARNINGS, 0)
    b.bump = 0.0
    for _ in range(int(p.steps)):
        _push(p, b, push)
        place, axes = vector(b.position), body_axes(b.orientation)
        call(a.set_state, a.model, a.memory, state.ctypes.data, a.signature)
        call(a.step, a.model, a.memory, 0, 0)
        call(a.get_state, a.model, a.memory, state.ctypes.data, a.signature)
        call(a.copy_bytes, sensors, a.sensors, 8 * (MUJOCO - TOUCH), 0)
        _read_contacts(b, place, axes)
        if b.bumps != 0.0:
            b.bump = 1.0
    call(a.copy_bytes, counters, a.warnings, 8 * N_WARNINGS, 0)
    warned = False
    for k in range(3):
        b.accel[k] = b.felt[k]
    for i in range(N_WARNINGS):
        warned |= b.warnings[i] != 0.0
    return _is_finite(numbers) and not warned
