"""One step of the wheels: drive, tyre, and what both do to the body. All in the body's frame."""

import math
from typing import Any

import hilserver.body.layout as at
from hilserver.plant.kernels import part
from hilserver.plant.tyre import traction

Vector = tuple[float, float, float]


@part
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@part
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@part
def vector(array: Any, first: int) -> Vector:
    """Return three numbers of an array."""
    return array[first], array[first + 1], array[first + 2]


@part
def _drive(p: Any, b: Any, i: int, asked: float, resistance_nm: float) -> tuple[float, float]:
    """Return torque of the drive and new speed of wheel `i`.

    Driven by speed, the torque is what it takes to turn as `asked` [rad/s]. Driven by torque,
    `asked` is a duty [%]: ``J w' = J/T1 (w_free - w) + floor`` is the slow lag of (5.23), stepped
    exactly where the floor does nothing.
    """
    inertia, step, speed = p[at.P_INERTIA], p[at.P_STEP], b[at.B_SPEED + i]
    if p[at.P_TORQUE] == 0.0:
        return inertia * (asked - speed) / step - resistance_nm, asked
    duty = asked + p[at.P_DUTY_KEEP] * (b[at.B_DUTY + i] - asked)
    b[at.B_DUTY + i] = duty
    torque = inertia * p[at.P_RATE] * (p[at.P_SPEED_PER_DUTY] * duty - speed)
    return torque, speed + (torque + resistance_nm) * step / inertia


@part
def _floor(p: Any, b: Any, i: int, velocity: Vector, turning: Vector) -> tuple[Vector, float]:
    """Return the floor's force on wheel `i` and the moment [Nm] with which it resists rolling.

    The tyre grips in the plane of the contact, along the wheel turned by the angle of its rollers.
    """
    n, r = vector(b, at.B_UP + 3 * i), vector(b, at.B_CONTACT + 3 * i)
    length = math.sqrt(n[0] * n[0] + n[2] * n[2])
    ahead = (n[2] / length, 0.0, -n[0] / length)
    left = cross(n, ahead)
    whirl = cross(turning, r)
    moving = (velocity[0] + whirl[0], velocity[1] + whirl[1], velocity[2] + whirl[2])
    rolling = p[at.P_RADIUS] * b[at.B_SPEED + i]
    slip, drift = rolling - dot(moving, ahead), dot(moving, left)
    b[at.B_SLIP + i] = slip
    cos, sin = p[at.P_COS + i], p[at.P_SIN + i]
    along, across = traction(
        cos * -slip + sin * drift, cos * drift + sin * slip, p[at.P_RATIO], p[at.P_V0]
    )
    grip = p[at.P_GRIP] * b[at.B_NORMAL + i]
    forward, sideways = grip * (cos * along - sin * across), grip * (sin * along + cos * across)
    force = (
        forward * ahead[0] + sideways * left[0],
        forward * ahead[1] + sideways * left[1],
        forward * ahead[2] + sideways * left[2],
    )
    fading = math.sqrt(rolling * rolling + p[at.P_V0] * p[at.P_V0])
    resistance = -p[at.P_ROLLING] * b[at.B_NORMAL + i] * p[at.P_RADIUS] * rolling / fading
    return force, resistance


@part
def turn_wheels(p: Any, b: Any, velocity: Vector, turning: Vector) -> tuple[Vector, Vector]:
    """Step the four wheels; return force and moment on the body.

    A wheel passes the floor's force on to its axle, the drive's torque acts back on the body. Both
    together are the force at the contact, the resistance to rolling, and the reaction to what
    accelerates the wheel.

    Parameters
    ----------
    velocity, turning : tuple of float
        Of the centre of mass [m/s] and of the body [rad/s].
    """
    fx, fy, fz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        force, moment, rolling = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0
        back = 0.0
        if b[at.B_NORMAL + i] > 0.0:
            force, rolling = _floor(p, b, i, velocity, turning)
            moment = cross(vector(b, at.B_CONTACT + 3 * i), force)
            back = p[at.P_RADIUS] * dot(force, _ahead(b, i))
        else:
            b[at.B_SLIP + i] = 0.0
        before = b[at.B_SPEED + i]
        torque, speed = _drive(p, b, i, b[at.B_ASKED + i], rolling - back)
        b[at.B_SPEED + i], b[at.B_TORQUE + i] = speed, torque
        b[at.B_ANGLE + i] += 0.5 * (before + speed) * p[at.P_STEP]
        fx, fy, fz = fx + force[0], fy + force[1], fz + force[2]
        mx, mz = mx + moment[0], mz + moment[2]
        my += moment[1] + rolling - p[at.P_INERTIA] * (speed - before) / p[at.P_STEP]
    return (fx, fy, fz), (mx, my, mz)


@part
def _ahead(b: Any, i: int) -> Vector:
    """Return the direction along the floor in the plane of wheel `i`."""
    up_x, up_z = b[at.B_UP + 3 * i], b[at.B_UP + 3 * i + 2]
    length = math.sqrt(up_x * up_x + up_z * up_z)
    return up_z / length, 0.0, -up_x / length
