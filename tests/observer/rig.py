"""A filter over made-up samples, and a drive whose truth is the filter's own model."""

import math
from dataclasses import dataclass

import numpy as np

from hilserver.observer import filter as observer
from hilserver.observer.consider import constants
from hilserver.observer.figures import MeasuredNoise, figures
from hilserver.observer.layout import (
    MOMENTS,
    N_ESTIMATED,
    N_FILTER,
    N_HEAD,
    N_MOMENT,
    OM,
    YAW,
    Head,
    Moment,
    V,
    X,
    Y,
)
from hilserver.observer.motion import move_on
from hilserver.observer.sensors import show_gyro, show_position, show_yaw
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters

DT_S = 0.02
MANY = {
    "wheel_radius": 0.02,
    "wheel_radius_difference": 0.01,
    "rotation_gain": 0.03,
    "rotation_gain_speed": 0.1,
    "longitudinal_slip": 0.05,
    "side_slip": 0.1,
    "wheel_misalignment": 0.02,
    "body_lag": 0.03,
    "encoder_scale.a": 0.02,
    "nav_lever_arm.x": 0.1,
    "nav_lever_arm.y": -0.05,
    "nav_scale": 0.02,
    "nav_frame_yaw": 0.03,
    "nav_position_bias.amplitude": 0.05,
    "heading_distortion.a1": 0.05,
    "heading_distortion.a2": 0.03,
    "gyro_scale": 0.02,
    "gyro_bias": 0.01,
}
"""Terms that all act on the observer."""
NOISE = {
    **{
        f"wheel.{wheel}.speed_rpm": MeasuredNoise(0.12)
        for wheel in ("fl", "rl", "fr", "rr")
    },
    "imu.gyro_z_rad_s": MeasuredNoise(0.006),
    "nav.x_m": MeasuredNoise(0.01, 0.05, 0.6),
    "nav.y_m": MeasuredNoise(0.01, 0.05, 0.6),
    "nav.yaw_rad": MeasuredNoise(0.005, 0.015, 2.0),
}


def robot(**terms):
    return RobotParameters(terms=terms)


class Observed:
    """A filter, moment by moment."""

    def __init__(self, robot, moved=(), unknown=None, instant_sd=0.0, **how):
        self.p = pack(robot)
        self.figures = figures(robot, NOISE, unknown=unknown, **how)
        self.figures.instant_sd = instant_sd  # the drives of this rig have no jumps
        self.c = constants(self.figures, moved)
        self.f = np.zeros(N_FILTER)

    @property
    def head(self):
        return Head.of(self.f)

    def moment(self, age=0):
        row = (int(self.head.newest) - age) % MOMENTS
        return Moment.of(self.f[N_HEAD + row * N_MOMENT :][:N_MOMENT])

    def step(
        self, time, left, right, *, apart=(0.0, 0.0), gyro=None, position=None, yaw=None
    ):
        """Go on to a time [s]; a sample is (time, values...)."""
        observer.open_moment(self.c, self.f, time, (left, right, 0.0, *apart))
        if gyro is not None:
            observer.add_gyro(self.f, *gyro)
        if position is not None:
            observer.add_position(self.f, *position)
        if yaw is not None:
            observer.add_yaw(self.f, *yaw)
        observer.close_moment(self.p, self.c, self.f)
        return self.moment()


def wheels(n, seed=0):
    """Return smooth speeds of both sides [rad/s], shape (n, 2); forward is left > 0, right < 0."""
    t, rng = DT_S * np.arange(n), np.random.default_rng(seed)
    a, b = rng.uniform(0.05, 0.3, 2)
    ahead, turn = 4.0 + 2.0 * np.sin(a * t), 2.5 * np.sin(b * t + 1.0)
    return np.column_stack([ahead - turn, -ahead - turn])


@dataclass
class Drive:
    """Exact and read values, a row per moment; `truth` is x, y, yaw, v, om."""

    times: np.ndarray
    read: np.ndarray
    truth: np.ndarray
    gyro: np.ndarray
    position: np.ndarray
    yaw: np.ndarray


def correlated(rng, n, sd, tau):
    keep, series = math.exp(-DT_S / tau), np.empty(n)
    state = sd * rng.standard_normal()
    for k in range(n):
        series[k] = state
        state = keep * state + sd * math.sqrt(1.0 - keep * keep) * rng.standard_normal()
    return series


def drive(p, figures, n, seed=0, exact=None):
    """Drive with parameters `p`: wheels, gyro and tag as noisy as the figures say."""
    rng = np.random.default_rng([seed, 1])
    exact = wheels(n, seed) if exact is None else exact
    before, now = Moment.zeros(), Moment.zeros()
    before.estimate[:3] = *rng.uniform(-2.0, 2.0, 2), rng.uniform(-math.pi, math.pi)
    truth, gyro, position, yaw = (
        np.empty((n, 5)),
        np.empty(n),
        np.empty((n, 2)),
        np.empty(n),
    )
    slow = [
        correlated(rng, n, figures.position_ou, figures.position_tau) for _ in range(2)
    ]
    slow_yaw = correlated(rng, n, figures.yaw_ou, figures.yaw_tau)
    for k in range(n):
        x = before.estimate
        if k:
            before.time, now.time = (k - 1) * DT_S, k * DT_S
            (before.left, before.right), (now.left, now.right) = exact[k - 1], exact[k]
            move_on(p, figures, before, now, now.estimate)
            before.estimate[:] = now.estimate
        truth[k] = x[[X, Y, YAW, V, OM]]
        gyro[k] = show_gyro(p, x, 0.0, 0.0) + figures.gyro_sd * rng.standard_normal()
        white = figures.position_sd * rng.standard_normal(2)
        position[k] = (
            np.array(show_position(p, x, 0.0, 0.0)) + white + [s[k] for s in slow]
        )
        yaw[k] = (
            show_yaw(p, x, 0.0) + slow_yaw[k] + figures.yaw_sd * rng.standard_normal()
        )
    read = exact + figures.wheel_sd * rng.standard_normal((n, 2))
    return Drive(DT_S * np.arange(n), read, truth, gyro, position, yaw)


def numerical(function, x, step=1e-6):
    """Return the derivative of a function of the state, shape (values, N_ESTIMATED)."""
    columns = []
    for j in range(N_ESTIMATED):
        up, down = x.copy(), x.copy()
        up[j] += step
        down[j] -= step
        columns.append(
            (np.array(function(up)) - np.array(function(down))) / (2.0 * step)
        )
    return np.array(columns).T
