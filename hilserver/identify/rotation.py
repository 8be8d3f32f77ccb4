"""K_om from wheel speeds and yaw rate, from all samples and from steady ones.

The correct form of the thesis's (2.34): for ``y = c u``, ``c = sum(u y) / sum(u^2)`` with
u = yaw_sign r (w_L + w_R) and y the yaw rate. As printed, (2.30) swaps U and Y and yields 1/c.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.optimize import minimize_scalar

from hilserver.arrays import Array, Indices, Mask
from hilserver.errors import LogError
from hilserver.identify.estimates import Estimate, blocks_of, regress
from hilserver.identify.wheels import at, files, need, per_span, present, side_sum_rpm
from hilserver.measured.channels import GYRO, IMU_YAW, SIDES, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.measured.lag import LARGEST_S, integral, lag_behind, wheel_motion
from hilserver.plant.layout import LEFT_WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

YAW_RATES: Final = (GYRO, IMU_YAW, YAW)
_LAG_STEP_S: Final = 0.02
_LAG_SMALLEST_S: Final = 0.005
_SLOPE_S: Final = 0.01
_YAW_STEP_S: Final = 0.5
_TURNING_RAD_S: Final = 0.05
_SAMPLES_MIN: Final = 20


@dataclass(frozen=True)
class RotationGain:
    """Estimates of K_om from a log."""

    channel: str  # source of the yaw rate
    zone_rpm: float
    configured: float
    # from all samples, and from those at which all wheels have been in the zone around their
    # set-points for the settling time
    unsteady: Estimate
    steady: Estimate | None
    steady_share: float
    # from all samples, estimated together with the lag of the yaw rate
    without_lag: Estimate | None
    lag_s: Estimate | None  # of the yaw rate behind the wheel speeds
    offset_rad_s: Estimate  # constant part of the yaw rate, if fitted as well
    flags: tuple[str, ...] = field(default=())  # why an estimate is not to be trusted


class _Samples:
    """Both sides of the equation from a log: yaw rate, and wheel speeds at any lag."""

    def __init__(self, log: MeasuredLog, robot: RobotParameters, channel: str) -> None:
        self.log = log
        self.robot = robot
        self.channel = channel
        self._factor = robot.yaw_sign * robot.wheel_radius_m * RAD_S_PER_RPM
        if channel.endswith("yaw_rad"):
            # Stretches of about half a second.
            rows: list[tuple[Array, Array, Array, Indices]] = []
            for span in range(len(log.spans)):
                t_s, yaw = log[channel].of(span)
                if len(t_s) < 2:
                    continue
                count = max(1, int((t_s[-1] - t_s[0]) / _YAW_STEP_S))
                ends_s = np.linspace(t_s[0], t_s[-1], count + 1)
                picked = np.unique(np.searchsorted(t_s, ends_s))
                picked = picked[picked < len(t_s)]
                turned = np.unwrap(yaw)[picked]
                starts = t_s[picked][:-1]
                ends = t_s[picked][1:]
                rows.append(
                    (
                        starts,
                        ends,
                        np.diff(turned) / (ends - starts),
                        np.full(len(ends), span),
                    )
                )
            if not rows:
                raise LogError(
                    f"{files(log)}: {channel} has too few samples for a yaw rate"
                )
            starts, ends, rate, owner = (
                np.concatenate(column) for column in zip(*rows, strict=True)
            )
            self.t_s = ends
            self._before_s = ends - starts
            self.y = rate
            self.span = owner.astype(np.int64)
        else:
            source = log[channel]
            self.t_s = source.t_s
            self.y = source.values
            self.span = source.span
            self._before_s = np.zeros(len(self.t_s))
        self.block = blocks_of(self.t_s, self.span)

    def lag_s(self) -> float | None:
        """Return the yaw rate's lag as a diagnosis finds it; None if the log is too short."""
        wheels = wheel_motion(self.log, self.robot)
        if wheels is None:
            return None
        is_angle = self.channel.endswith("yaw_rad")
        source = self.log[self.channel]
        angle = source if is_angle else integral(source)
        found = lag_behind(wheels[1], angle, is_angle=is_angle)
        return None if found is None else found.offset_s

    def u(self, lag_s: float = 0.0) -> Array:
        """Return yaw_sign r (w_L + w_R) [m/s] at the stamps minus the lag; NaN without speeds."""
        out = np.full(len(self.t_s), np.nan)
        for span in range(len(self.log.spans)):
            rows = slice(*np.searchsorted(self.span, [span, span + 1]))
            t_s = self.t_s[rows] - lag_s
            before_s = self._before_s[rows]
            if before_s.any():
                out[rows] = self._mean_speed(span, t_s, before_s)
            else:
                out[rows] = side_sum_rpm(self.log, span, t_s)
        return self._factor * out

    def _mean_speed(self, span: int, t_s: Array, before_s: Array) -> Array:
        """Return the mean of w_L + w_R over the stretch before each stamp."""
        left = present(self.log, "speed_rpm", LEFT_WHEELS)[0]
        grid = self.log[f"wheel.{left}.speed_rpm"].of(span)[0]
        speed = side_sum_rpm(self.log, span, grid)
        grid = grid[np.isfinite(speed)]
        speed = speed[np.isfinite(speed)]
        if len(grid) < 2:
            return np.full(len(t_s), np.nan)
        both = speed[1:] + speed[:-1]
        steps = 0.5 * both * np.diff(grid)
        angle = np.concatenate(([0.0], np.cumsum(steps)))
        ends = [
            np.interp(at_s, grid, angle, np.nan, np.nan)
            for at_s in (t_s - before_s, t_s)
        ]
        mean: Array = (ends[1] - ends[0]) / before_s
        return mean

    def steady(self, zone_rpm: float, settle_s: float) -> Mask:
        """Return where all wheels have been near their set-points for the settling time."""
        good = np.ones(len(self.t_s), dtype=bool)
        for wheel in present(self.log, "setpoint_rpm", present(self.log, "speed_rpm")):
            name = f"wheel.{wheel}.speed_rpm"
            speed = self.log[name]
            aim = per_span(
                self.log,
                name,
                lambda span, t_s, w=wheel: at(  # type: ignore[misc]
                    self.log[f"wheel.{w}.setpoint_rpm"], span, t_s, hold=True
                ),
            )
            away = ~(np.abs(speed.values - aim) <= zone_rpm)
            away |= np.diff(aim, prepend=aim[:1]) != 0.0
            for span in range(len(self.log.spans)):
                rows = slice(*np.searchsorted(self.span, [span, span + 1]))
                own = slice(*np.searchsorted(speed.span, [span, span + 1]))
                if own.stop == own.start:
                    good[rows] = False
                    continue
                last_s = np.where(away[own], speed.t_s[own], -np.inf)
                left_s = np.maximum.accumulate(last_s)
                left_s = np.maximum(left_s, speed.t_s[own][0])
                index = (
                    np.searchsorted(speed.t_s[own], self.t_s[rows], side="right") - 1
                )
                before_s = self.t_s[rows] - self._before_s[rows]
                since_s = before_s - left_s[np.maximum(index, 0)]
                good[rows] &= (index >= 0) & (since_s >= settle_s)
        return good


def _yaw_rate_of(log: MeasuredLog) -> str:
    """Return the yaw rate to use; LogError without one, or without a speed on both sides."""
    channel = next((name for name in YAW_RATES if name in log), None)
    if channel is None:
        raise LogError(f"{files(log)}: K_om needs one of {', '.join(YAW_RATES)}")
    for side in SIDES:
        if not present(log, "speed_rpm", side):
            need(log, f"wheel.{side[0]}.speed_rpm")
    return channel


def _doubts(
    channel: str, gain: Estimate, offset: Estimate, gain_without_offset: float
) -> list[str]:
    """Return what an offset of the yaw rate or a wrong sign does to K_om."""
    found = []
    if not offset.holds(0.0) and abs(gain_without_offset / gain.value - 1.0) > 0.01:
        found.append(
            f"{channel} has an offset of {offset.value:.4f} rad/s; without it K_om is "
            f"{gain_without_offset:.4g} 1/m: turn equally long in both directions"
        )
    if gain.ci95 is not None and gain.ci95[1] < 0.0:
        found.append(
            "K_om is negative: the yaw or the wheels of both sides have the wrong sign"
        )
    return found


def identify_rotation(
    log: MeasuredLog,
    robot: RobotParameters,
    *,
    zone_rpm: float = 3.0,
    settle_s: float = 0.3,
) -> RotationGain:
    """Identify K_om.

    LogError without wheel speeds of both sides, without a yaw rate, or without turning.

    Parameters
    ----------
    zone_rpm : float
        A wheel this close to its set-point is steady ...
    settle_s : float
        ... once it has been for this long, because a late sensor still shows the change.
    """
    channel = _yaw_rate_of(log)
    data = _Samples(log, robot, channel)
    u = data.u()
    good = np.isfinite(u)
    turning = 2.0 * np.sqrt(np.mean(u[good] ** 2)) if good.any() else 0.0
    if good.sum() < _SAMPLES_MIN or turning < _TURNING_RAD_S:
        raise LogError(
            f"{files(log)}: the robot hardly turns; K_om needs a drive with turns on the spot"
        )
    unsteady = regress(u[good, None], data.y[good], data.block[good])
    columns = np.stack([u[good], np.ones(good.sum())], 1)
    free = regress(columns, data.y[good], data.block[good])
    flags: list[str] = []
    steady, share = _steady(data, u, good, zone_rpm, settle_s, flags)
    lag, without_lag = _lag(data) if log.has_stamps else (None, None)
    value = unsteady.estimate(0, "1/m")
    offset = free.estimate(1, "rad/s")
    if lag is not None and without_lag is not None:
        _flag_lag(lag, value, without_lag, flags)
    flags += _doubts(channel, value, offset, float(free.values[0]))
    return RotationGain(
        channel,
        zone_rpm,
        robot.k_om,
        value,
        steady,
        share,
        without_lag,
        lag,
        offset,
        tuple(flags),
    )


def _steady(
    data: _Samples,
    u: Array,
    good: Mask,
    zone_rpm: float,
    settle_s: float,
    flags: list[str],
) -> tuple[Estimate | None, float]:
    """Return K_om from steady turning, and the share of steady samples."""
    if not present(data.log, "setpoint_rpm", present(data.log, "speed_rpm")):
        flags.append("no set-points in the log: no steady estimate")
        return None, 0.0
    chosen = good & data.steady(zone_rpm, settle_s)
    share = float(chosen.sum() / max(good.sum(), 1))
    if chosen.sum() < _SAMPLES_MIN or not np.any(
        np.abs(u[chosen]) > 0.5 * _TURNING_RAD_S
    ):
        flags.append(
            f"the wheels are never within {zone_rpm:g} rpm of their set-points for {settle_s:g}"
            " s while the robot turns: no steady estimate (is the drive saturated, or the zone"
            " too narrow?)"
        )
        return None, share
    found = regress(u[chosen, None], data.y[chosen], data.block[chosen])
    return found.estimate(0, "1/m"), share


def _lag(data: _Samples) -> tuple[Estimate | None, Estimate | None]:
    """Fit the yaw rate's lag and K_om together; None if nothing in the log changes fast."""

    def misfit(lag_s: float) -> float:
        u = data.u(lag_s)
        good = np.isfinite(u)
        product = u[good] @ data.y[good]
        gain = float(product / (u[good] @ u[good]))
        left = data.y[good] - gain * u[good]
        return float(np.mean(np.square(left)))

    robust_s = data.lag_s()
    if robust_s is None:
        grid = np.arange(-LARGEST_S, LARGEST_S + 1e-9, _LAG_STEP_S)
        misfits = [misfit(lag_s) for lag_s in grid]
        robust_s = float(grid[int(np.argmin(misfits))])
    best = robust_s
    near = (best - _LAG_STEP_S, best + _LAG_STEP_S)
    best = float(minimize_scalar(misfit, bounds=near, method="bounded").x)
    u, later, sooner = data.u(best), data.u(best + _SLOPE_S), data.u(best - _SLOPE_S)
    slope = (later - sooner) / (2.0 * _SLOPE_S)
    good = np.isfinite(u) & np.isfinite(slope)
    power = np.mean(u[good] ** 2)
    least = 0.02 * math.sqrt(power)
    if np.mean(slope[good] ** 2) < least**2:
        return None, None
    gain = float(u[good] @ data.y[good] / (u[good] @ u[good]))
    table = np.stack([u[good], gain * slope[good]], axis=1)
    found = regress(table, data.y[good], data.block[good])
    gain_estimate = found.estimate(0, "1/m")
    rest = found.estimate(1, "s")
    if rest.ci95 is None:
        interval = None
    else:
        interval = (best + rest.ci95[0], best + rest.ci95[1])
    return Estimate(best + rest.value, interval, "s"), gain_estimate


def _flag_lag(
    lag: Estimate, unsteady: Estimate, corrected: Estimate, flags: list[str]
) -> None:
    sure = not lag.holds(0.0) and abs(lag.value) > _LAG_SMALLEST_S
    if sure and abs(corrected.value - unsteady.value) > 0.005 * abs(corrected.value):
        flags.append(
            f"the yaw rate comes {lag.value * 1e3:.0f} ms after the wheels' speeds: the unsteady "
            f"estimate {unsteady.value:.4g} 1/m is wrong, {corrected.value:.4g} without the lag"
        )
