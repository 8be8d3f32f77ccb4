"""Clocks: the clocks of tag and gyro against that of the wheels, offset and drift.

Without the model, a late tag and a late clock look alike. A clock shows in heading and position
that are late by the same time, early instead of late, or increasingly late.
"""

from dataclasses import replace

import numpy as np

from hilserver.diagnosis.checks.support import data_fault
from hilserver.diagnosis.schema.findings import Finding
from hilserver.measured.channels import GYRO, YAW
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.measured.lag import Lag, integral, lag_behind, path_of, wheel_motion
from hilserver.measured.thresholds import CLOCK_LEAST_S, CLOCK_SURE_SD
from hilserver.plant.parameters import RobotParameters


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find offset and drift of the clock of navigation or inertial unit; stamps are corrected."""
    if not log.has_stamps:
        return log, []
    wheels = wheel_motion(log, robot)
    if wheels is None:
        return log, []
    speed, rate = wheels
    findings: list[Finding] = []
    yaw = lag_behind(rate, log.channels.get(YAW), is_angle=True)
    position = lag_behind(speed, path_of(log), is_angle=False)
    gyro = lag_behind(rate, integral(log.channels.get(GYRO)), is_angle=False)
    for source, prefix, lags in (
        ("navigation", "nav.", [lag for lag in (yaw, position) if lag is not None]),
        ("IMU", "imu.", [gyro] if gyro is not None else []),
    ):
        judged = _judge(lags)
        if judged is None:
            continue
        drifts, lag = judged
        names = [name for name in log.channels if name.startswith(prefix)]
        findings.append(_finding(source, names, lag, drifts=drifts))
        log = log.with_channels(
            {name: _moved(log[name], lag, drifts=drifts) for name in names}
        )
    return log, findings


def _judge(lags: list[Lag]) -> tuple[bool, Lag] | None:
    """Return whether the clock drifts, and the best estimate.

    None if a late source explains it as well.
    """
    if not lags:
        return None
    best = min(lags, key=lambda lag: lag.offset_sd_s)
    if best.drifts and _agree(
        [(g.drift, g.drift_sd) for g in lags], 1e-4, CLOCK_SURE_SD
    ):
        return True, best
    if not _agree(
        [(g.offset_s, g.offset_sd_s) for g in lags], 0.5 * CLOCK_LEAST_S, 2.5
    ):
        return None
    together = len(lags) > 1 and all(
        abs(g.offset_s) > 3.0 * g.offset_sd_s for g in lags
    )
    return (False, best) if best.is_early or (best.is_off and together) else None


def _agree(figures: list[tuple[float, float]], least: float, most_sd: float) -> bool:
    values = [value for value, _ in figures]
    sd = float(np.hypot.reduce([sd for _, sd in figures]))
    return max(values) - min(values) <= max(least, most_sd * sd)


def _finding(source: str, names: list[str], lag: Lag, *, drifts: bool) -> Finding:
    if drifts:
        value, sd, unit = lag.drift, lag.drift_sd, "s/s"
        text = (
            f"The clock of the {source} drifts by {1e6 * value:+.0f} us per second relative"
            " to that of the wheels"
        )
    else:
        value, sd, unit = lag.offset_s, lag.offset_sd_s, "s"
        text = (
            f"The time stamps of the {source} are offset by {value:+.3f} s "
            "from those of the wheels"
        )
    explanation = (
        f"{text}: take both from the same clock; the time stamps were corrected."
    )
    interval = (value - 1.96 * sd, value + 1.96 * sd)
    cause = "clock_drift" if drifts else "clock_offset"
    return data_fault(cause, names, value, interval, unit, explanation)


def _moved(channel: Channel, lag: Lag, *, drifts: bool) -> Channel:
    shift = lag.offset_s + (lag.drift * (channel.t_s - lag.middle_s) if drifts else 0.0)
    return replace(channel, t_s=channel.t_s - shift)
