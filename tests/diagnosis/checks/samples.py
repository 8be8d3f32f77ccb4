"""A robot that drives ideally, drawn anew for every seed: exact kinematics, noisy sensors."""

import numpy as np

from hilserver.measured.data import Channel, MeasuredLog, Span
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters

ROBOT = RobotParameters()
RAD_S = np.pi / 30.0


def drive(
    seed=0,
    *,
    length_s=240.0,
    rate_hz=50.0,
    noise=1.0,
    k_om=1.0,
    moves_s=2.0,
    sent_hz=None,
    lag_s=0.02,
):
    """Return t [s] and the columns of a drive whose set-points slew to new values now and then."""
    rng = np.random.default_rng(seed)
    n = int(length_s * rate_hz)
    t = np.arange(n) / rate_hz
    every = int(moves_s * rate_hz)
    v = np.repeat(rng.uniform(-0.1, 0.5, n // every + 1), every)[:n]
    om = np.repeat(rng.uniform(-0.8, 0.8, n // every + 1), every)[:n]
    wanted = np.stack(
        [
            v / 0.085 - om / (2 * 0.085 * ROBOT.k_om),
            v / 0.085 + om / (2 * 0.085 * ROBOT.k_om),
        ]
    )
    sent = np.zeros((2, n))
    for k in range(1, n):
        step = 2.0 / rate_hz
        sent[:, k] = sent[:, k - 1] + np.clip(
            wanted[:, k] - sent[:, k - 1], -10 * step, 10 * step
        )
    if sent_hz is not None:
        group = np.floor(t * sent_hz + 0.3)
        sent = sent[:, np.searchsorted(group, group)]
    wheel = np.zeros_like(sent)
    share = 1.0 - np.exp(-1.0 / (rate_hz * lag_s))
    for k in range(1, n):
        wheel[:, k] = wheel[:, k - 1] + share * (sent[:, k - 1] - wheel[:, k - 1])
    left, right = wheel
    speed = 0.085 * (left + right) / 2.0
    turn = k_om * 0.085 * ROBOT.k_om * (right - left)
    yaw = rng.uniform(-3, 3) + np.cumsum(turn) / rate_hz
    x, y = (
        np.cumsum(speed * np.cos(yaw)) / rate_hz,
        np.cumsum(speed * np.sin(yaw)) / rate_hz,
    )
    wobble = lambda sd, tau: noise * sd * _correlated(rng, n, tau * rate_hz)  # noqa: E731
    columns = {}
    for name, side, sign in zip(WHEELS, (0, 0, 1, 1), (1, 1, -1, -1), strict=True):
        columns[f"wheel.{name}.setpoint_rpm"] = sign * sent[side] / RAD_S
        measured = sign * wheel[side] / RAD_S + noise * 0.12 * rng.standard_normal(n)
        columns[f"wheel.{name}.speed_rpm"] = measured
    columns["imu.gyro_z_rad_s"] = turn + noise * 0.006 * rng.standard_normal(n)
    columns["nav.x_m"] = x + wobble(0.05, 0.6)
    columns["nav.y_m"] = y + wobble(0.05, 0.6)
    columns["nav.yaw_rad"] = np.angle(np.exp(1j * (yaw + wobble(0.015, 2.0))))
    due = np.diff(np.floor(t * 20.0 + 1e-9), prepend=-1.0) > 0
    for name in ("nav.x_m", "nav.y_m", "nav.yaw_rad"):
        columns[name][~due] = np.nan
    return t, columns


def _correlated(rng, n, tau):
    a = np.exp(-1.0 / tau)
    out, state, steps = np.empty(n), 0.0, rng.standard_normal(n)
    for k in range(n):
        state = a * state + np.sqrt(1 - a * a) * steps[k]
        out[k] = state
    return out


def log_of(t, columns, spans=1, **how):
    """Return the log of a table, cut into equal spans."""
    span = np.minimum(np.arange(len(t)) * spans // len(t), spans - 1)
    bounds = [np.flatnonzero(span == i)[[0, -1]] for i in range(spans)]
    channels = {}
    for name, values in columns.items():
        there = np.isfinite(values)
        channels[name] = Channel(t[there], values[there], span[there])
    return MeasuredLog(
        (),
        channels,
        tuple(Span(i, None, t[a], t[b]) for i, (a, b) in enumerate(bounds)),
        **how,
    )
