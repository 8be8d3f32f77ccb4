"""Clocks: the clocks of tag and gyro against that of the wheels, offset and drift.

Without the model, a late tag and a late clock look alike. A clock shows in heading and position
that are late by the same time, early instead of late, or increasingly late.
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.support import along, data_fault, row_period_s
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import CLOCK_FEWEST_CHUNKS, CLOCK_LEAST_S, OUTLIER_SD
from hilserver.measured.channels import GYRO, TAG, YAW
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import LEFT_WHEELS, RIGHT_WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

LARGEST_S: Final = 1.0  # largest offset that is searched for
CHUNK_S: Final = 30.0  # stretch of the log with its own offset
BASELINE_S: Final = 1.0  # distance and turn are compared over this time
GRID_S = 0.02


@dataclass(frozen=True, slots=True)
class Lag:
    """Delay of a source relative to the wheels: offset + drift t."""

    # in the middle of the log
    offset_s: float
    offset_sd_s: float
    # [s/s]
    drift: float
    drift_sd: float
    # of the log
    middle_s: float
    length_s: float

    @property
    def is_early(self) -> bool:
        """Whether the source clearly shows a motion before it happens."""
        return self.offset_s < -max(CLOCK_LEAST_S, OUTLIER_SD * self.offset_sd_s)

    @property
    def is_off(self) -> bool:
        """Whether there clearly is a delay of either sign."""
        return abs(self.offset_s) > max(CLOCK_LEAST_S, OUTLIER_SD * self.offset_sd_s)

    @property
    def drifts(self) -> bool:
        """Whether the delay clearly grows."""
        return (
            abs(self.drift) > OUTLIER_SD * self.drift_sd
            and abs(self.drift) * self.length_s > CLOCK_LEAST_S
        )


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find offset and drift of the clock of navigation or inertial unit; stamps are corrected."""
    if not log.has_stamps:
        return log, []
    wheels = _wheel_motion(log, robot)
    if wheels is None:
        return log, []
    speed, rate = wheels
    findings: list[Finding] = []
    yaw = _lag(rate, log.channels.get(YAW), is_angle=True)
    position = _lag(speed, _path(log), is_angle=False)
    gyro = _lag(rate, _integral(log.channels.get(GYRO)), is_angle=False)
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
        log = log.with_channels({name: _moved(log[name], lag, drifts=drifts) for name in names})
    return log, findings


def _judge(lags: list[Lag]) -> tuple[bool, Lag] | None:
    """Return whether the clock drifts, and the best estimate.

    None if a late source explains it as well.
    """
    if not lags:
        return None
    best = min(lags, key=lambda lag: lag.offset_sd_s)
    if best.drifts and _agree([(g.drift, g.drift_sd) for g in lags], 1e-4, OUTLIER_SD):
        return True, best
    if not _agree([(g.offset_s, g.offset_sd_s) for g in lags], 0.5 * CLOCK_LEAST_S, 2.5):
        return None
    together = len(lags) > 1 and all(abs(g.offset_s) > 3.0 * g.offset_sd_s for g in lags)
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
            f"The time stamps of the {source} are offset by {value:+.3f} s from those of the wheels"
        )
    explanation = f"{text}: take both from the same clock; the time stamps were corrected."
    interval = (value - 1.96 * sd, value + 1.96 * sd)
    cause = "clock_drift" if drifts else "clock_offset"
    return data_fault(cause, names, value, interval, unit, explanation)


def _moved(channel: Channel, lag: Lag, *, drifts: bool) -> Channel:
    shift = lag.offset_s + (lag.drift * (channel.t_s - lag.middle_s) if drifts else 0.0)
    return replace(channel, t_s=channel.t_s - shift)


Motion = tuple[Channel, Channel]


def _wheel_motion(log: MeasuredLog, robot: RobotParameters) -> Motion | None:
    """Return forward and turning speed of the wheels, up to a factor.

    One wheel per side is enough, but not if a mecanum robot moves sideways: its wheels then differ.
    """
    taken = slice(None) if robot.is_mecanum else slice(1)
    sides = [[f"wheel.{w}.speed_rpm" for w in s[taken]] for s in (LEFT_WHEELS, RIGHT_WHEELS)]
    if not log.has(*sides[0], *sides[1]):
        return None
    first = log[sides[0][0]]
    if row_period_s(first) > CLOCK_LEAST_S:
        return None
    left, right = (
        np.mean([_at(first, log[name], log[name].values) for name in side], axis=0)
        for side in sides
    )
    forward = first.with_values((left - right) * RAD_S_PER_RPM)
    turning = first.with_values(-(left + right) * RAD_S_PER_RPM)
    return forward, turning


def _at(channel: Channel, other: Channel, values: Array) -> Array:
    """Return values of another channel at the stamps of this one."""
    result: Array = np.interp(along(channel), along(other), values)
    return result


def _integral(channel: Channel | None) -> Channel | None:
    if channel is None or len(channel) < 2:
        return None
    step = np.diff(channel.t_s) * (channel.values[1:] + channel.values[:-1]) / 2.0
    step[np.diff(channel.span) != 0] = 0.0
    return channel.with_values(np.concatenate(([0.0], np.cumsum(step))))


def _path(log: MeasuredLog) -> Channel | None:
    """Return the distance that the tag has moved along the heading."""
    if not log.has(*TAG):
        return None
    x, y, yaw = (log[f"nav.{what}"] for what in ("x_m", "y_m", "yaw_rad"))
    heading = _at(x, yaw, np.unwrap(yaw.values))
    middle = (heading[1:] + heading[:-1]) / 2.0
    step = np.diff(x.values) * np.cos(middle) + np.diff(_at(x, y, y.values)) * np.sin(middle)
    step[np.diff(x.span) != 0] = 0.0
    return x.with_values(np.concatenate(([0.0], np.cumsum(step))))


def _lag(rate: Channel, path: Channel | None, *, is_angle: bool) -> Lag | None:
    """Return how late `path` is behind the integral of `rate`, over chunks of the longest span."""
    whole = _integral(rate)
    if path is None or whole is None:
        return None
    span = int(np.bincount(path.span).argmax())
    t_path, s_path = path.of(span)
    t_rate, s_rate = whole.of(span)
    if len(t_path) < 100 or len(t_rate) < 100:
        return None
    s_path = np.unwrap(s_path) if is_angle else s_path
    begin = max(t_path[0], t_rate[0]) + LARGEST_S
    end = min(t_path[-1], t_rate[-1]) - LARGEST_S
    n = int((end - begin) / CHUNK_S)
    if n < CLOCK_FEWEST_CHUNKS:
        return None
    borders = np.linspace(begin, end, n + 1)
    delays = np.array(
        [_delay(t_rate, s_rate, t_path, s_path, first, last) for first, last in pairwise(borders)]
    )
    middle = (borders[:-1] + borders[1:]) / 2.0
    good = np.isfinite(delays)
    if good.sum() < CLOCK_FEWEST_CHUNKS:
        return None
    return _line_through(middle[good], delays[good], float(end - begin))


def _line_through(t: Array, delay: Array, length_s: float) -> Lag | None:
    """Fit offset and drift, leaving out chunks far from the others."""
    keep = np.ones(len(t), dtype=np.bool_)
    for _ in range(2):
        slope, at_zero = np.polyfit(t[keep], delay[keep], 1)
        error = np.abs(delay - slope * t - at_zero)
        keep = error <= max(4.0 * float(np.median(error)), 0.02)
    if keep.sum() < CLOCK_FEWEST_CHUNKS:
        return None
    slope, at_zero = np.polyfit(t[keep], delay[keep], 1)
    error = delay[keep] - slope * t[keep] - at_zero
    sd = max(float(np.sqrt((error**2).sum() / (keep.sum() - 2))), 0.003)
    middle = float(t[keep].mean())
    spread = float(np.sqrt(((t[keep] - middle) ** 2).sum()))
    offset = float(slope * middle + at_zero)
    return Lag(offset, sd / float(np.sqrt(keep.sum())), float(slope), sd / spread, middle, length_s)


def _delay(t_rate: Array, s_rate: Array, t: Array, s: Array, begin: float, end: float) -> float:
    """Return the delay with which distances over a second fit best; NaN without motion."""
    first, last = np.searchsorted(t, [begin, end])
    times = t[first:last]
    if len(times) < 50:
        return float("nan")
    way = s[first:last] - np.interp(times - BASELINE_S, t, s)
    tries = np.arange(-LARGEST_S, LARGEST_S + GRID_S / 2, GRID_S)
    at = times - tries[:, None]
    left = _unexplained(
        way, np.interp(at, t_rate, s_rate) - np.interp(at - BASELINE_S, t_rate, s_rate)
    )
    best = int(np.argmin(left))
    if not 0 < best < len(tries) - 1 or left[best] > 0.5:
        return float("nan")
    a, b, c = left[best - 1 : best + 2]
    return float(tries[best] + GRID_S * 0.5 * (a - c) / max(a - 2 * b + c, 1e-12))


def _unexplained(y: Array, x: Array) -> Array:
    """Return the share of the variance of y, shape (n,), that no line in each row of x explains."""
    y, x = y - y.mean(), x - x.mean(axis=1, keepdims=True)
    total = (y**2).sum() * (x**2).sum(axis=1)
    share = np.divide((x * y).sum(axis=1) ** 2, total, out=np.zeros(len(x)), where=total > 0.0)
    return np.asarray(1.0 - share)
