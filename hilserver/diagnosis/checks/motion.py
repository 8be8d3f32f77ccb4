"""Mean motion in windows of a second, according to wheels, gyro and navigation."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.checks.support import SPAN_S, along, slope_of
from hilserver.measured.channels import SIDES
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

MOTION_WINDOW_S = 1.0


@dataclass(frozen=True, slots=True)
class MotionWindows:
    """Windows of a log."""

    # shape (n,): stamps as `support.along` makes them [s]
    begin: Array
    end: Array

    def __len__(self) -> int:
        return len(self.begin)


def windows_of(log: MeasuredLog, width_s: float = MOTION_WINDOW_S) -> MotionWindows:
    """Cut the spans into windows of about `width_s`."""
    edges = []
    for index, span in enumerate(log.spans):
        n = max(round((span.end_s - span.start_s) / width_s), 1)
        times = np.linspace(span.start_s, span.end_s, n + 1) + SPAN_S * index
        edges.append(np.stack([times[:-1], times[1:]]))
    begin, end = np.concatenate(edges, axis=1)
    return MotionWindows(begin, end)


def mean_in(channel: Channel, windows: MotionWindows) -> Array:
    """Return the mean of a channel in each window, NaN where it has no sample."""
    times = along(channel)
    first, last = (
        np.searchsorted(times, windows.begin),
        np.searchsorted(times, windows.end),
    )
    total = np.concatenate(([0.0], np.cumsum(channel.values)))
    count = last - first
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(count > 0, (total[last] - total[first]) / count, np.nan)


def ends_in(channel: Channel, windows: MotionWindows) -> tuple[Array, Array, Array]:
    """Return first value, last value and time between them in each window."""
    times = along(channel)
    first = np.searchsorted(times, windows.begin)
    last = np.searchsorted(times, windows.end, side="right") - 1
    good = (last - first >= 1) & (first < len(times))
    first, last = np.minimum(first, len(times) - 1), np.maximum(last, 0)
    between = np.where(good, times[last] - times[first], np.nan)
    return (
        np.where(good, channel.values[first], np.nan),
        np.where(good, channel.values[last], np.nan),
        between,
    )


def rate_in(angle: Channel, windows: MotionWindows, turn: float = 2.0 * np.pi) -> Array:
    """Return the mean rate of an angle that wraps at `turn` in each window."""
    step = np.diff(angle.values)
    step = np.where(np.diff(angle.span) == 0, step - turn * np.rint(step / turn), 0.0)
    continuous = Channel(
        angle.t_s, np.concatenate(([0.0], np.cumsum(step))), angle.span
    )
    first, last, between = ends_in(continuous, windows)
    return (last - first) / between


def side_mean(
    log: MeasuredLog, side: Iterable[str], what: str, windows: MotionWindows
) -> Array | None:
    """Return the mean of the wheels of one side [rad/s], None if there are none."""
    found = [
        mean_in(log[name], windows)
        for wheel in side
        if (name := f"wheel.{wheel}.{what}") in log
    ]
    return None if not found else np.mean(found, axis=0) * RAD_S_PER_RPM


def lateral_mean(log: MeasuredLog, what: str, windows: MotionWindows) -> Array | None:
    """Return how fast mecanum wheels roll to the left [rad/s], None if one is missing."""
    names = [f"wheel.{wheel}.{what}" for wheel in WHEELS]
    if not log.has(*names):
        return None
    fl, rl, fr, rr = (mean_in(log[name], windows) for name in names)
    return np.asarray(0.25 * RAD_S_PER_RPM * (rl - fl + rr - fr))


def rolled(
    log: MeasuredLog, what: str, windows: MotionWindows, robot: RobotParameters
) -> Array | None:
    """Return how fast the wheels would move the robot ahead, back or sideways [m/s]."""
    left, right = (side_mean(log, side, what, windows) for side in SIDES)
    lateral = lateral_mean(log, what, windows) if robot.is_mecanum else 0.0
    if left is None or right is None or lateral is None:
        return None
    return np.asarray(robot.wheel_radius_m * np.hypot(0.5 * (left - right), lateral))


def turned(
    log: MeasuredLog, windows: MotionWindows, robot: RobotParameters
) -> Array | None:
    """Return the turn rate by the wheels, or else by their set-points [rad/s]."""
    for what in ("speed_rpm", "setpoint_rpm"):
        left, right = (side_mean(log, side, what, windows) for side in SIDES)
        if left is not None and right is not None:
            return np.asarray(
                robot.yaw_sign * robot.wheel_radius_m * robot.k_om * (left + right)
            )
    return None


@dataclass(frozen=True, slots=True)
class Line:
    """A line through the origin."""

    slope: float
    correlation: float
    n: int  # windows with motion


def line(y: Array | None, x: Array | None, least: float = 0.0) -> Line | None:
    """Return y = slope x, without outliers; None if there is too little data.

    Parameters
    ----------
    least : float
        Windows with a smaller |x| do not count as motion.
    """
    if x is None or y is None:
        return None
    good = np.isfinite(x) & np.isfinite(y)
    x, y = x[good], y[good]
    if (np.abs(x) > least).sum() < 10 or not (x**2).sum() or not (y**2).sum():
        return None
    # it begins where no wild value can move it, and leaves out the tenth that is farthest from it
    slope = slope_of(y, x)
    for _ in range(4):
        error = np.abs(y - slope * x)
        keep = error <= np.quantile(error, 0.9)
        slope = float((x[keep] * y[keep]).sum() / max((x[keep] ** 2).sum(), 1e-300))
    correlation = float(
        (x[keep] * y[keep]).sum()
        / max(np.sqrt((x[keep] ** 2).sum() * (y[keep] ** 2).sum()), 1e-300)
    )
    return Line(slope, correlation, int((np.abs(x[keep]) > least).sum()))


def finite(*columns: Array) -> Mask:
    """Return where all columns have a value."""
    return np.asarray(np.isfinite(np.stack(columns)).all(axis=0))
