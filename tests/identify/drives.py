"""Logs of a robot that the tests write themselves: the thesis's wheel loop in steps of 0.1 ms."""

import numpy as np

from hilserver.measured.data import Channel, LogSource, MeasuredLog, Span
from hilserver.plant.layout import WHEELS

STEP_S = 1e-4


def loop(setpoint_rpm, gain=1.11, t1_s=0.069, t2_s=0.0023):
    """Speed and duty for a set-point per step of 0.1 ms."""
    speed, duty = np.zeros(len(setpoint_rpm)), np.zeros(len(setpoint_rpm))
    x = n = integral = 0.0
    for i, aim in enumerate(setpoint_rpm):
        wish = 13.513 * (aim - n) + integral
        u = min(max(wish, -100.0), 100.0)
        integral += STEP_S * (195.84 * (aim - n) + (u - wish) / 0.0715)
        speed[i], duty[i] = n, u
        x += STEP_S * (gain * u - x) / t1_s
        n += STEP_S * (x - n) / t2_s
    return speed, duty


def correlated(rng, t_s, sd, tau_s):
    """Noise with correlation time `tau_s`."""
    keep = np.exp(-np.diff(t_s, prepend=t_s[0]) / tau_s)
    out = np.empty(len(t_s))
    out[0] = level = sd * rng.normal()
    for i in range(1, len(t_s)):
        level = keep[i] * level + sd * np.sqrt(1.0 - keep[i] ** 2) * rng.normal()
        out[i] = level
    return out


def measured(t_s, values, has_stamps=True):
    """One span with all channels at the same stamps."""
    span = np.zeros(len(t_s), dtype=np.int64)
    return MeasuredLog(
        (LogSource("drive.csv", "0" * 64),),
        {name: Channel(t_s, np.asarray(v, float), span) for name, v in values.items()},
        (Span(0, None, float(t_s[0]), float(t_s[-1])),),
        has_stamps,
    )


def spins(
    k_om, *, imu_late_s=0.0, reverse_s=2.0, duration_s=120.0, rng, rate_hz=50, **extra
):
    """Spins to alternate sides; all wheels the same sign, so w_L + w_R = 2 w."""
    fine_s = np.arange(0.0, duration_s, STEP_S)
    aim = 60.0 * np.where((fine_s // reverse_s) % 2 == 0, 1.0, -1.0)
    speed, duty = loop(aim)
    turn = -k_om * 0.085 * 2.0 * speed * 2.0 * np.pi / 60.0
    t_s = np.arange(1.0, duration_s - 0.1, 1.0 / rate_hz)
    values = {}
    for wheel in WHEELS:
        values[f"wheel.{wheel}.setpoint_rpm"] = aim[np.round(t_s / STEP_S).astype(int)]
        seen = np.interp(t_s, fine_s, speed) + 0.12 * rng.normal(size=len(t_s))
        values[f"wheel.{wheel}.speed_rpm"] = seen
        values[f"wheel.{wheel}.duty_pct"] = np.interp(t_s, fine_s, duty)
    noise = correlated(rng, t_s, 0.006, 0.5)
    values["imu.gyro_z_rad_s"] = np.interp(t_s - imu_late_s, fine_s, turn) + noise
    yaw = np.cumsum(turn) * STEP_S
    values["imu.yaw_rad"] = np.interp(t_s - imu_late_s, fine_s, yaw)
    return t_s, values
