"""The mechatronic model's run in a slice: show what the last run computed, then compute the next.

What is computed from tick k is shown, and acts, exactly one slice later.
"""

import math
from typing import Any

import hilserver.body.layout as at
from hilserver.body.wheels import Vector, dot, turn_wheels, vector
from hilserver.compiled.foreign import call
from hilserver.plant.kernels import part

GRAZING = 0.01
"""A contact that leans further over than this, as share of its normal, carries no tyre force."""


@part
def body_axes(q: Any, first: int) -> tuple[Vector, Vector, Vector]:
    """Return the body's axes in the world's frame, from a unit quaternion."""
    w, x, y, z = q[first], q[first + 1], q[first + 2], q[first + 3]
    return (
        (1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y + w * z), 2.0 * (x * z - w * y)),
        (2.0 * (x * y - w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z + w * x)),
        (2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)),
    )


@part
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


@part
def _push(p: Any, b: Any, push: int) -> None:
    """Step the wheels and let their forces, and the air's, act in MuJoCo's next step."""
    axes = body_axes(b, at.B_QPOS + 3)
    velocity, turning = to_body(axes, vector(b, at.B_QVEL)), vector(b, at.B_QVEL + 3)
    force, moment = turn_wheels(p, b, velocity, turning)
    drag = p[at.P_AIR] * math.sqrt(dot(velocity, velocity))
    force = (
        force[0] - drag * velocity[0],
        force[1] - drag * velocity[1],
        force[2] - drag * velocity[2],
    )
    force, moment = to_world(axes, force), to_world(axes, moment)
    for i in range(3):
        b[push + i], b[push + 3 + i] = force[i], moment[i]


@part
def _read_contacts(b: Any, place: Vector, axes: tuple[Vector, Vector, Vector]) -> None:
    """Keep normal force, point and direction of every wheel's contact, in the body's frame.

    `place` and `axes` are those that the sensors were computed with, before the step moved them.
    """
    for i in range(4):
        first = at.B_SENSORS + at.S_CONTACT + 6 * i
        up = to_body(axes, vector(b, first))
        size = math.sqrt(dot(up, up))
        sign = 1.0 if up[2] >= 0.0 else -1.0
        b[at.B_NORMAL + i] = size if up[0] * up[0] + up[2] * up[2] > GRAZING * size * size else 0.0
        if b[at.B_NORMAL + i] == 0.0:
            continue
        where = vector(b, first + 3)
        where = to_body(axes, (where[0] - place[0], where[1] - place[1], where[2] - place[2]))
        for k in range(3):
            b[at.B_UP + 3 * i + k] = sign * up[k] / size
            b[at.B_CONTACT + 3 * i + k] = where[k]


@part
def _is_finite(b: Any) -> bool:
    total = 0.0
    for i in range(at.B_QVEL + 6):
        total += abs(b[i])
    return math.isfinite(total)


@part
def place_body(p: Any, b: Any, x: float, y: float, yaw: float) -> None:
    """Stand the body at rest on the floor."""
    for i in range(at.B_POSE_REQUEST):
        b[i] = 0.0
    for i in range(at.B_MUJOCO + 1, b.shape[0]):
        b[i] = 0.0
    b[at.B_FAILED] = 0.0
    b[at.B_QPOS], b[at.B_QPOS + 1], b[at.B_QPOS + 2] = x, y, p[at.P_REST_HEIGHT]
    b[at.B_QPOS + 3], b[at.B_QPOS + 6] = math.cos(0.5 * yaw), math.sin(0.5 * yaw)
    b[at.B_ACCEL + 2] = 9.81


@part
def advance(p: Any, b: Any, a: Any) -> bool:
    """Compute one slice, driven by ``b[B_ASKED:]``; return whether the state is still good.

    Parameters
    ----------
    p : ndarray of float64, shape (N_P,)
    b : ndarray of float64
        State, changed in place; all that MuJoCo knows is set from it and read back.
    a : ndarray of int64, shape (N_A,)
    """
    model, data, signature = a[at.A_MODEL], a[at.A_DATA], a[at.A_SIGNATURE]
    state, sensors = b[at.B_MUJOCO :].ctypes.data, b[at.B_SENSORS :].ctypes.data
    counters = b[at.B_WARNINGS :].ctypes.data
    for i in range(at.N_WARNINGS):
        b[at.B_WARNINGS + i] = 0.0
    call(a[at.A_COPY], a[at.A_WARNINGS], counters, 8 * at.N_WARNINGS, 0)
    for _ in range(int(p[at.P_STEPS])):
        _push(p, b, at.B_MUJOCO + a[at.A_PUSH])
        place, axes = vector(b, at.B_QPOS), body_axes(b, at.B_QPOS + 3)
        call(a[at.A_SET_STATE], model, data, state, signature)
        call(a[at.A_STEP], model, data, 0, 0)
        call(a[at.A_GET_STATE], model, data, state, signature)
        call(a[at.A_COPY], sensors, a[at.A_SENSORS], 8 * at.N_SENSORS, 0)
        _read_contacts(b, place, axes)
    call(a[at.A_COPY], counters, a[at.A_WARNINGS], 8 * at.N_WARNINGS, 0)
    for k in range(3):
        b[at.B_ACCEL + k] = b[at.B_SENSORS + at.S_ACCEL + k]
    warned = False
    for i in range(at.N_WARNINGS):
        warned |= b[at.B_WARNINGS + i] != 0.0
    return _is_finite(b) and not warned
