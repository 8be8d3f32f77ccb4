"""How late one source is behind another, by what both show of the same motion.

Distances over a second are compared at every delay, in stretches of the log, and the line through
their delays leaves out those far from the others. A few wild samples spoil one stretch, not the
answer. `hilserver identify` and the data checks of a diagnosis use this one estimate.
"""

from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.measured.channels import TAG
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.measured.thresholds import (
    CLOCK_FEWEST_CHUNKS,
    CLOCK_LEAST_S,
    CLOCK_SLOWEST_S,
    CLOCK_SURE_SD,
)
from hilserver.plant.layout import LEFT_WHEELS, RIGHT_WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

LARGEST_S: Final = 1.0  # largest offset that is searched for
CHUNK_S: Final = 30.0  # stretch of the log with its own offset
BASELINE_S: Final = 1.0  # distance and turn are compared over this time
GRID_S: Final = 0.02
STRETCH_SAMPLES: Final = 50  # of a stretch
MOST_LEFT: Final = 0.5  # share of the variance that the best delay may leave
SPAN_S: Final = 1e6  # longer than any span, so that the stamps of two spans differ


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
    # a smaller offset is a latency, or hidden by slow samples
    least_s: float = CLOCK_LEAST_S

    @property
    def is_early(self) -> bool:
        """Whether the source clearly shows a motion before it happens."""
        return self.offset_s < -max(self.least_s, CLOCK_SURE_SD * self.offset_sd_s)

    @property
    def is_off(self) -> bool:
        """Whether there clearly is a delay of either sign."""
        return abs(self.offset_s) > max(self.least_s, CLOCK_SURE_SD * self.offset_sd_s)

    @property
    def drifts(self) -> bool:
        """Whether the delay clearly grows."""
        size = abs(self.drift)
        is_sure = size > CLOCK_SURE_SD * self.drift_sd
        return is_sure and size * self.length_s > self.least_s


def wheel_motion(
    log: MeasuredLog, robot: RobotParameters
) -> tuple[Channel, Channel] | None:
    """Return forward and turning speed of the wheels, up to a factor.

    One wheel per side is enough, but not if a mecanum robot moves sideways: its wheels then differ.
    """
    taken = slice(None) if robot.is_mecanum else slice(1)
    lefts = [f"wheel.{wheel}.speed_rpm" for wheel in LEFT_WHEELS[taken]]
    rights = [f"wheel.{wheel}.speed_rpm" for wheel in RIGHT_WHEELS[taken]]
    if not log.has(*lefts, *rights):
        return None
    first = log[lefts[0]]
    if _period_s(first) > CLOCK_SLOWEST_S:
        return None

    def mean(side: list[str]) -> Array:
        """Return the mean speed of a side at the stamps of the first wheel."""
        speeds = [_at(first, log[name], log[name].values) for name in side]
        return np.asarray(np.mean(speeds, axis=0))

    left, right = mean(lefts), mean(rights)
    forward = first.with_values((left - right) * RAD_S_PER_RPM)
    turning = first.with_values(-(left + right) * RAD_S_PER_RPM)
    return forward, turning


def _along(channel: Channel) -> Array:
    """Return stamps that rise over all spans [s]."""
    result: Array = channel.t_s + SPAN_S * channel.span
    return result


def _period_s(channel: Channel) -> float:
    """Return the usual time between two samples; 0 if there are too few."""
    steps = np.diff(channel.t_s)[np.diff(channel.span) == 0]
    return float(np.median(steps)) if len(steps) else 0.0


def _at(channel: Channel, other: Channel, values: Array) -> Array:
    """Return values of another channel at the stamps of this one."""
    result: Array = np.interp(_along(channel), _along(other), values)
    return result


def integral(channel: Channel | None) -> Channel | None:
    """Return the integral of a rate; between spans it stands still."""
    if channel is None or len(channel) < 2:
        return None
    middle = (channel.values[1:] + channel.values[:-1]) / 2.0
    step = np.diff(channel.t_s) * middle
    return channel.with_values(_summed(step, channel))


def path_of(log: MeasuredLog) -> Channel | None:
    """Return the distance that the tag has moved along the heading."""
    if not log.has(*TAG):
        return None
    x, y, yaw = (log[name] for name in TAG)
    heading = _at(x, yaw, np.unwrap(yaw.values))
    middle = (heading[1:] + heading[:-1]) / 2.0

    along_x = np.diff(x.values)
    along_y = np.diff(_at(x, y, y.values))
    step = along_x * np.cos(middle) + along_y * np.sin(middle)
    return x.with_values(_summed(step, x))


def _summed(step: Array, channel: Channel) -> Array:
    """Return the sum of the steps of a channel, of which none crosses two spans."""
    inside = np.diff(channel.span) == 0
    total = np.cumsum(np.where(inside, step, 0.0))
    return np.concatenate(([0.0], total))


def lag_behind(rate: Channel, path: Channel | None, *, is_angle: bool) -> Lag | None:
    """Return how late `path` is behind the integral of `rate`, over chunks of the longest span."""
    whole = integral(rate)
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
    found = []
    for first, last in pairwise(borders):
        found.append(_delay(t_rate, s_rate, t_path, s_path, first, last))
    delays = np.array(found)
    middle = (borders[:-1] + borders[1:]) / 2.0
    good = np.isfinite(delays)
    if good.sum() < CLOCK_FEWEST_CHUNKS:
        return None
    least_s = max(CLOCK_LEAST_S, 2.0 * _period_s(rate))
    return _line_through(middle[good], delays[good], float(end - begin), least_s)


def _line_through(
    t: Array, delay: Array, length_s: float, least_s: float
) -> Lag | None:
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
    offset_sd = sd / float(np.sqrt(keep.sum()))
    return Lag(offset, offset_sd, float(slope), sd / spread, middle, length_s, least_s)


def _delay(
    t_rate: Array, s_rate: Array, t: Array, s: Array, begin: float, end: float
) -> float:
    """Return the delay with which distances over a second fit best; NaN without motion."""
    first, last = np.searchsorted(t, [begin, end])
    times = t[first:last]
    if len(times) < STRETCH_SAMPLES:
        return float("nan")
    way = s[first:last] - np.interp(times - BASELINE_S, t, s)

    tries = np.arange(-LARGEST_S, LARGEST_S + GRID_S / 2, GRID_S)
    at = times - tries[:, None]
    ends = np.interp(at, t_rate, s_rate)
    begins = np.interp(at - BASELINE_S, t_rate, s_rate)
    # The share of the variance that no line in the changes of the angle explains.
    turned = ends - begins
    y = way - way.mean()
    x = turned - turned.mean(axis=1, keepdims=True)
    total = (y**2).sum() * (x**2).sum(axis=1)
    common = (x * y).sum(axis=1) ** 2
    none = np.zeros(len(x))
    share = np.divide(common, total, out=none, where=total > 0.0)
    left = np.asarray(1.0 - share)

    best = int(np.argmin(left))
    is_inside = 0 < best < len(tries) - 1
    if not is_inside or left[best] > MOST_LEFT:
        return float("nan")

    # the lowest point of the parabola through three tries
    a, b, c = left[best - 1 : best + 2]
    bend = max(a - 2 * b + c, 1e-12)
    return float(tries[best] + GRID_S * 0.5 * (a - c) / bend)
