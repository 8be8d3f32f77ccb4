"""Follows a figure of eight: only the control law, as pure functions of pose and time step.

A point at the distance d ahead of the robot is led along the path by feedback linearisation: its
velocity u is chosen freely and gives the robot's v and om, because the point can move sideways
although the robot cannot::

        u = path velocity + k (path point - point ahead)
        v  =  u_x cos yaw + u_y sin yaw
        om = (u_y cos yaw - u_x sin yaw) / d

The path point waits if the robot is far behind (saturated wheels, a restart elsewhere).
"""

import math
from dataclasses import dataclass

from hilserver.plant.layout import LEFT_WHEELS, RIGHT_WHEELS, WHEELS
from hilserver.plant.units import RPM_PER_RAD_S


@dataclass(frozen=True, slots=True)
class Pose:
    """Pose of the robot in the world [m], [m], [rad]."""

    x_m: float
    y_m: float
    yaw_rad: float


@dataclass(frozen=True, slots=True)
class Robot:
    """Nominal values for the inverse kinematics (5.25)."""

    wheel_radius_m: float = 0.085
    k_om_per_m: float = 0.31 / (0.25**2 + 0.31**2)  # om = yaw_sign r K_om (w_L + w_R)
    yaw_sign: int = -1
    max_rpm: float = 90.0  # limit of every wheel


@dataclass(frozen=True, slots=True)
class Eight:
    """A horizontal eight around the origin: x = a sin s, y = b sin 2s."""

    # a and b [m]
    half_width_m: float = 1.5
    half_height_m: float = 0.75
    speed_m_s: float = 0.35  # speed of the path point

    def point_m(self, s: float) -> tuple[float, float]:
        """Return the path point (x, y) [m] at the parameter `s` [rad]."""
        x_m = self.half_width_m * math.sin(s)
        y_m = self.half_height_m * math.sin(2 * s)
        return x_m, y_m

    def tangent_m(self, s: float) -> tuple[float, float]:
        """Return d(x, y)/ds [m]; never zero."""
        x_m = self.half_width_m * math.cos(s)
        y_m = 2 * self.half_height_m * math.cos(2 * s)
        return x_m, y_m


@dataclass(frozen=True, slots=True)
class Gains:
    """Tuning of the law."""

    ahead_m: float = 0.15  # distance d of the led point
    pull_per_s: float = 1.5  # k
    # at this distance from the path point the point stands still
    patience_m: float = 0.6


@dataclass(frozen=True, slots=True)
class PathCommand:
    """Output of the control law."""

    s: float  # parameter of the path point after this step [rad]
    error_m: float  # distance of the led point from the path point
    # ``fl``, ``rl``, ``fr``, ``rr``; right wheels mirrored
    wheels_rpm: dict[str, float]


STOP = dict.fromkeys(WHEELS, 0.0)


def wheel_speeds_rpm(robot: Robot, v_m_s: float, om_rad_s: float) -> dict[str, float]:
    """Return the wheel speeds of a twist (5.25), all scaled together to the limit."""
    straight = v_m_s / robot.wheel_radius_m
    turning = om_rad_s / (2 * robot.yaw_sign * robot.wheel_radius_m * robot.k_om_per_m)
    left = RPM_PER_RAD_S * (straight + turning)
    right = RPM_PER_RAD_S * (turning - straight)
    scale = min(1.0, robot.max_rpm / max(abs(left), abs(right), 1e-12))
    # 90 * (x / 90) may exceed x by the last bit, and the daemon refuses values above its limit.
    limit = robot.max_rpm
    left, right = (max(-limit, min(limit, side * scale)) for side in (left, right))
    return dict.fromkeys(LEFT_WHEELS, left) | dict.fromkeys(RIGHT_WHEELS, right)


def follow(
    eight: Eight, robot: Robot, gains: Gains, s: float, pose: Pose, step_s: float
) -> PathCommand:
    """Return wheel speeds and the next path point for one cycle.

    Parameters
    ----------
    s : float
        Parameter of the present path point [rad].
    step_s : float
        Length of the cycle [s].
    """
    cos_yaw = math.cos(pose.yaw_rad)
    sin_yaw = math.sin(pose.yaw_rad)
    target_x, target_y = eight.point_m(s)
    error_x = target_x - (pose.x_m + gains.ahead_m * cos_yaw)
    error_y = target_y - (pose.y_m + gains.ahead_m * sin_yaw)
    error_m = math.hypot(error_x, error_y)

    along_x, along_y = eight.tangent_m(s)
    waiting = max(0.0, 1.0 - error_m / gains.patience_m)
    s_rate = waiting * eight.speed_m_s / math.hypot(along_x, along_y)

    u_x = along_x * s_rate + gains.pull_per_s * error_x
    u_y = along_y * s_rate + gains.pull_per_s * error_y
    v_m_s = u_x * cos_yaw + u_y * sin_yaw
    om_rad_s = (u_y * cos_yaw - u_x * sin_yaw) / gains.ahead_m
    next_s = math.fmod(s + s_rate * step_s, 2 * math.pi)
    return PathCommand(next_s, error_m, wheel_speeds_rpm(robot, v_m_s, om_rad_s))


WHEEL_RPM = 20.0
WHEEL_START_S, WHEEL_TURNS_S, WHEEL_EVERY_S = 1.5, 1.5, 2.5


def one_wheel_rpm(elapsed_s: float) -> dict[str, float]:
    """Return the speeds of the commissioning pattern: fl, rl, fr, rr alone, forward, once each."""
    turn, rest_s = divmod(elapsed_s - WHEEL_START_S, WHEEL_EVERY_S)
    wheels = tuple(STOP)
    if not 0 <= turn < len(wheels) or rest_s >= WHEEL_TURNS_S:
        return STOP
    wheel = wheels[int(turn)]
    return STOP | {wheel: WHEEL_RPM if wheel.endswith("l") else -WHEEL_RPM}
