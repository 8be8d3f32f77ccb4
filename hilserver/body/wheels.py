"""One step of the wheels: drive, tyre, and their effect on the body, in the body's frame."""

import math
from typing import Any

from hilserver.body.layout import BodyMotion, Constants
from hilserver.compiled import inlined, part
from hilserver.plant.tyre import traction

Vector = tuple[float, float, float]


@inlined
def cross(a: Vector, b: Vector) -> Vector:
    """Return the vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


@inlined
def dot(a: Vector, b: Vector) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def vector(array: Any) -> Vector:
    """Return the three numbers of an array."""
    return array[0], array[1], array[2]


@inlined
def _drive(
    p: Constants, b: BodyMotion, i: int, asked: float, resistance_nm: float
) -> tuple[float, float]:
    """Return torque of the drive and new speed of wheel `i`.

    Driven by speed, the torque is that needed to turn at `asked` [rad/s]. Driven by torque,
    `asked` is a duty [%]: ``J w' = J/T1 (w_free - w) + floor`` is the slow lag of (5.23), stepped
    exactly if the floor exerts no force.
    """
    inertia, step, speed = p.inertia, p.dt, b.speed[i]
    if p.torque == 0.0:
        return inertia * (asked - speed) / step - resistance_nm, asked
    duty = asked + p.duty_keep * (b.duty[i] - asked)
    b.duty[i] = duty
    torque = inertia * p.rate * (p.speed_per_duty * duty - speed)
    return torque, speed + (torque + resistance_nm) * step / inertia


@inlined
def _floor(
    p: Constants, b: BodyMotion, i: int, velocity: Vector, turning: Vector
) -> tuple[Vector, float]:
    """Return the floor's force on wheel `i` and its moment [Nm] against rolling.

    The tyre grips in the plane of the contact, along the wheel turned by the angle of its rollers.
    """
    n, r = vector(b.up[i]), vector(b.contact[i])
    length = math.sqrt(n[0] * n[0] + n[2] * n[2])
    ahead = (n[2] / length, 0.0, -n[0] / length)
    left = cross(n, ahead)
    whirl = cross(turning, r)
    moving = (velocity[0] + whirl[0], velocity[1] + whirl[1], velocity[2] + whirl[2])
    rolling = p.radius * b.speed[i]
    slip, drift = rolling - dot(moving, ahead), dot(moving, left)
    b.slip[i] = slip
    cos, sin = p.cos[i], p.sin[i]
    along, across = traction(
        cos * -slip + sin * drift, cos * drift + sin * slip, p.ratio, p.v0
    )
    grip = p.grip * b.normal[i]
    forward, sideways = (
        grip * (cos * along - sin * across),
        grip * (sin * along + cos * across),
    )
    force = (
        forward * ahead[0] + sideways * left[0],
        forward * ahead[1] + sideways * left[1],
        forward * ahead[2] + sideways * left[2],
    )
    fading = math.sqrt(rolling * rolling + p.v0 * p.v0)
    resistance = -p.rolling * b.normal[i] * p.radius * rolling / fading
    return force, resistance


@part
def turn_wheels(
    p: Constants, b: BodyMotion, velocity: Vector, turning: Vector
) -> tuple[Vector, Vector]:
    """Step the four wheels; return force and moment on the body.

    A wheel passes the floor's force on to its axle, and the drive's torque reacts on the body. In
    sum these are the force at the contact, the rolling resistance, and the reaction to the
    acceleration of the wheel.

    Parameters
    ----------
    velocity, turning : tuple of float
        Of the centre of mass [m/s] and of the body [rad/s].
    """
    fx, fy, fz, mx, my, mz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(4):
        force, moment, rolling = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), 0.0
        back = 0.0
        if b.normal[i] > 0.0:
            force, rolling = _floor(p, b, i, velocity, turning)
            moment = cross(vector(b.contact[i]), force)
            back = p.radius * dot(force, _ahead(b, i))
        else:
            b.slip[i] = 0.0
        before = b.speed[i]
        torque, speed = _drive(p, b, i, b.asked[i], rolling - back)
        b.speed[i], b.torque[i] = speed, torque
        b.angle[i] += 0.5 * (before + speed) * p.dt
        fx, fy, fz = fx + force[0], fy + force[1], fz + force[2]
        mx, mz = mx + moment[0], mz + moment[2]
        my += moment[1] + rolling - p.inertia * (speed - before) / p.dt
    return (fx, fy, fz), (mx, my, mz)


@inlined
def _ahead(b: BodyMotion, i: int) -> Vector:
    """Return the direction along the floor in the plane of wheel `i`."""
    up_x, up_z = b.up[i, 0], b.up[i, 2]
    length = math.sqrt(up_x * up_x + up_z * up_z)
    return up_z / length, 0.0, -up_x / length
