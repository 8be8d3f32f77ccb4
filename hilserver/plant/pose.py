"""Step 11 of the tick: the pose, moved along an exact arc, and the wrap of yaw (5.24)."""

import math

import numpy as np

from hilserver.compiled import inlined
from hilserver.plant.layout import Inputs, State

TURN = 2.0 * math.pi
# below this, the series' next term is under half a unit in the last place
SERIES_LIMIT_RAD = 0.05


@inlined
def wrap(angle_rad: float) -> float:
    """Return the angle in (-pi, pi]; one already there keeps every bit.

    ``fmod`` and the one subtraction that follows are exact, so the result is the true remainder by
    the double nearest to 2 pi and wrapping twice changes nothing.
    """
    if -math.pi < angle_rad <= math.pi:
        return angle_rad
    rest = np.fmod(angle_rad, TURN)
    if rest > math.pi:
        return float(rest - TURN)
    if rest <= -math.pi:
        return float(rest + TURN)
    return float(rest)


@inlined
def sinc(half_rad: float) -> float:
    """Return sin(h)/h: the ratio of chord to arc when the heading turns by 2 h."""
    if abs(half_rad) < SERIES_LIMIT_RAD:
        square = half_rad * half_rad
        return 1.0 - square * (
            1.0 / 6.0 - square * (1.0 / 120.0 - square * (1.0 / 5040.0))
        )
    return math.sin(half_rad) / half_rad


@inlined
def shift(
    yaw: float, v: float, vy: float, om: float, dt_s: float
) -> tuple[float, float]:
    """Return the displacement [m] after `dt_s` of constant body velocity [m/s, m/s, rad/s].

    The chord of the arc points along the mean heading, and its length is sin(h)/h of the arc's, so
    one sine and one cosine give the exact end point.
    """
    half = 0.5 * om * dt_s
    chord, heading = dt_s * sinc(half), yaw + half
    cos, sin = math.cos(heading), math.sin(heading)
    return chord * (v * cos - vy * sin), chord * (v * sin + vy * cos)


@inlined
def turn(yaw: float, om: float, dt_s: float) -> float:
    """Return the heading after `dt_s` of constant turn rate."""
    half = 0.5 * om * dt_s
    return float(wrap(yaw + half + half))


@inlined
def move(x: State, v: float, vy: float, om: float, dt_s: float) -> None:
    """Move the pose over `dt_s` with constant body velocity."""
    dx, dy = shift(x.pose[2], v, vy, om, dt_s)
    x.pose[0] += dx
    x.pose[1] += dy
    x.pose[2] = turn(x.pose[2], om, dt_s)


@inlined
def set_pose(x: State, u: Inputs) -> None:
    """Place the robot at the hidden input `pose`, once per change of the request counter."""
    if u.pose_request != x.pose_request:
        x.pose_request = u.pose_request
        x.pose[0] = u.pose[0]
        x.pose[1] = u.pose[1]
        x.pose[2] = wrap(u.pose[2])
