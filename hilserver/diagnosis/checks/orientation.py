"""Signs and sides: wheels, gyro, heading and position must show the same turn.

The order of the questions matters: the wheels are judged by their set-points, the heading by the
course over ground, and only then whether the remaining channels turn the same way. A base whose
yaw runs against the measurement is a matter of sign, never of K_om. A heading that stands askew
to the course is that of a rigid body whose axis is not the robot's: it is turned back by its angle.
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.motion import (
    Line,
    ends_in,
    finite,
    lateral_mean,
    line,
    mean_in,
    rate_in,
    side_mean,
    turned,
    windows_of,
)
from hilserver.diagnosis.checks.support import data_fault, listed
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    AXIS_SURE,
    FEWEST_PIECES,
    LARGEST_SKEW_RAD,
    SIGN_AHEAD,
    SIGN_SURE,
    SLOWEST_TURN_RAD_S,
)
from hilserver.measured.channels import GYRO, IMU_YAW, NAV_X, NAV_Y, SIDES, TAG, YAW
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import LEFT_WHEELS, RIGHT_WHEELS, WHEELS
from hilserver.plant.parameters import RobotParameters

MIRROR = dict(zip(WHEELS, RIGHT_WHEELS + LEFT_WHEELS, strict=True))
Found = tuple[MeasuredLog, list[Finding]]


def find(log: MeasuredLog, robot: RobotParameters) -> Found:
    """Find wrong signs and swapped sides, and correct them."""
    findings: list[Finding] = []
    for judge in (_wheels_by_setpoints, _frame, _axis, _wheels_by_navigation, _turning):
        log, found = judge(log, robot)
        findings += found
    return log, findings


def _flipped(log: MeasuredLog, names: Sequence[str], sure: float, text: str) -> Found:
    """Return the log with the signs of channels reversed, and the finding."""
    log = log.with_channels(
        {name: log[name].with_values(-log[name].values) for name in names}
    )
    explanation = f"{listed(names)}: {text}; the sign was reversed."
    interval = (-1.0 - (1.0 - sure), -1.0 + (1.0 - sure))
    return log, [data_fault("sign_flip", names, -1.0, interval, "1", explanation)]


def _swapped(
    log: MeasuredLog, kinds: Sequence[str], signs: dict[str, float], text: str
) -> Found:
    """Return the log with the wheels of both sides swapped, times `signs` of each kind."""
    changed: dict[str, Channel] = {}
    for kind in kinds:
        for wheel, other in MIRROR.items():
            if (source := f"wheel.{other}.{kind}") in log:
                channel = log[source]
                changed[f"wheel.{wheel}.{kind}"] = channel.with_values(
                    signs[kind] * channel.values
                )
    finding = data_fault(
        "swapped_sides",
        sorted(changed),
        1.0,
        None,
        "1",
        f"The columns of the left and right wheels are swapped: {text}; they were swapped back.",
    )
    return log.with_channels(changed), [finding]


def _wheels_by_setpoints(log: MeasuredLog, _robot: RobotParameters) -> Found:
    """Fit each measured speed to the set-points of its own and of the other side."""
    windows = windows_of(log, 0.5)
    weights: dict[str, tuple[float, float]] = {}
    for wheel, other in MIRROR.items():
        names = [f"wheel.{wheel}.speed_rpm", f"wheel.{wheel}.setpoint_rpm"]
        names.append(f"wheel.{other}.setpoint_rpm")
        if log.has(*names):
            fit = _two_weights(*(mean_in(log[name], windows) for name in names))
            if fit is not None:
                weights[wheel] = fit
    crossed = [
        w for w, (own, other) in weights.items() if abs(other) > 0.5 + 2 * abs(own)
    ]
    if len(crossed) >= 2 and len(crossed) == len(weights):
        sign = float(np.sign(np.median([weights[w][1] for w in crossed])))
        kinds = ["speed_rpm"]
        return _swapped(
            log,
            kinds,
            dict.fromkeys(kinds, sign),
            "the speeds follow the set-points of the other side",
        )
    against = [w for w, (own, other) in weights.items() if own < -0.2 - 2 * abs(other)]
    if not against:
        return log, []
    names = [f"wheel.{w}.speed_rpm" for w in against]
    return _flipped(
        log, names, 0.99, "the speed has the opposite sign of its set-point"
    )


def _two_weights(y: Array, own: Array, other: Array) -> tuple[float, float] | None:
    """Return a, b of y = a own + b other; None if it does not fit or the two are too alike."""
    good = finite(y, own, other)
    if good.sum() < FEWEST_PIECES:
        return None
    x = np.stack([own[good], other[good]], axis=1)
    y = y[good]
    size = np.linalg.norm(x, axis=0)
    if not size.all() or np.linalg.cond(x / size) > 20.0:
        return _one_weight(y, x, size)
    solution = np.linalg.lstsq(x, y, rcond=None)[0]
    left = float(((y - x @ solution) ** 2).sum() / max((y**2).sum(), 1e-300))
    return (float(solution[0]), float(solution[1])) if left < 1 - SIGN_SURE**2 else None


def _one_weight(y: Array, x: Array, size: Array) -> tuple[float, float] | None:
    """Return the weight of the own set-point if the other side always does the same."""
    if not size[0]:
        return None
    found = line(y, x[:, 0])
    if found is None or abs(found.correlation) < SIGN_SURE:
        return None
    mirrored = float((x[:, 0] * x[:, 1]).sum())
    return (found.slope, 0.0) if mirrored < 0 else None


class _Course(NamedTuple):
    """Motion of the tag in the windows in which course and heading belong together."""

    course: Array  # over ground [rad]
    yaw: Array  # [rad]
    speed: Array  # [m/s]
    rolled: Array  # speed forward by the wheels, up to a factor; NaN without them


def _course(log: MeasuredLog, robot: RobotParameters) -> _Course | None:
    """Return course over ground, heading and speed in each window where they belong together."""
    moved, windows = _moved(log), windows_of(log)
    lateral = (
        lateral_mean(log, "speed_rpm", windows)
        if robot.is_mecanum
        else np.zeros(len(windows))
    )
    if moved is None or lateral is None:
        return None
    dx, dy, dt, cosine, sine = moved
    way_m = np.hypot(dx, dy)
    aside_m = robot.wheel_radius_m * np.abs(lateral) * dt
    good = finite(dx, dy, cosine)
    good &= way_m > 0.1
    good &= aside_m < SIGN_AHEAD * way_m
    good &= np.hypot(cosine, sine) > 0.9  # did not turn much in the window

    rolled = np.full(len(windows), np.nan)
    left, right = (side_mean(log, side, "speed_rpm", windows) for side in SIDES)
    if left is not None and right is not None:
        rolled = left - right

    course = np.arctan2(dy, dx)
    yaw = np.arctan2(sine, cosine)
    speed = way_m / dt
    return _Course(course[good], yaw[good], speed[good], rolled[good])


def _moved(log: MeasuredLog) -> tuple[Array, Array, Array, Array, Array] | None:
    """Return distance along x and y, time, and mean cosine and sine of the heading by window."""
    if not log.has(*TAG):
        return None
    windows = windows_of(log)
    x0, x1, dt = ends_in(log[NAV_X], windows)
    y0, y1, _ = ends_in(log[NAV_Y], windows)
    yaw = log[YAW]
    cosine = mean_in(yaw.with_values(np.cos(yaw.values)), windows)
    sine = mean_in(yaw.with_values(np.sin(yaw.values)), windows)
    return x1 - x0, y1 - y0, dt, cosine, sine


def _frame(log: MeasuredLog, robot: RobotParameters) -> Found:
    """Judge the heading by the course over ground: their difference must be constant, not the sum.

    The angles are doubled, so that driving backwards counts the same.
    """
    found = _course(log, robot)
    if found is None or len(found.course) < FEWEST_PIECES:
        return log, []
    course, yaw, speed, _ = found
    alike = _resultant(2.0 * (course - yaw), speed)
    mirrored = _resultant(2.0 * (course + yaw), speed)
    if mirrored < SIGN_SURE or mirrored < alike + 0.3:
        return log, []
    rate = rate_in(log[YAW], windows_of(log))
    others = [
        line(rate, other, SLOWEST_TURN_RAD_S) for other in _other_rates(log, robot)
    ]
    votes = [
        np.sign(o.slope)
        for o in others
        if o is not None and abs(o.correlation) > SIGN_SURE
    ]
    if sum(votes) > 0:
        text = "the y axis of the tag points right: its course turns opposite to its heading"
        return _flipped(log, [NAV_Y], mirrored, text)
    text = "the heading turns opposite to the course over ground"
    return _flipped(log, [YAW], mirrored, text)


def _axis(log: MeasuredLog, robot: RobotParameters) -> Found:
    """Turn back the heading of a rigid body whose axis is not the robot's.

    Small angles are left to the fit; a body that looks backward, to the wheels' own check.
    """
    found = _course(log, robot)
    if found is None or len(found.course) < FEWEST_PIECES:
        return log, []
    backward = np.where(found.rolled < 0.0, np.pi, 0.0)
    off = found.yaw - found.course + backward
    toward = np.exp(1j * off)

    # the mean is where most are; the median of what is left of it is moved by no wild one
    mean = float(np.angle((found.speed * toward).sum()))
    away = np.angle(toward * np.exp(-1j * mean))
    middle = float(np.median(away))
    askew_rad = float(np.angle(np.exp(1j * (mean + middle))))
    spread = np.abs(away - middle)
    half = 1.96 * 1.4826 * float(np.median(spread)) / np.sqrt(len(spread))

    # an angle that may be small is: errors of the position turn the course as well
    of_axis = abs(np.sin(askew_rad)) > np.sin(min(LARGEST_SKEW_RAD + half, 0.5 * np.pi))
    if not of_axis or _resultant(off, found.speed) < AXIS_SURE:
        return log, []

    yaw = log[YAW]
    turned_back = np.angle(np.exp(1j * (yaw.values - askew_rad)))
    text = (
        f"The heading stands askew to the course by {np.degrees(askew_rad):.1f} degrees: the axis"
        " of the tracked rigid body is not that of the robot. The heading was turned back; turn"
        " the body's frame in the tracking system."
    )
    interval = (askew_rad - half, askew_rad + half)
    finding = data_fault("nav_frame_yaw", [YAW], askew_rad, interval, "rad", text)
    return log.with_channels({YAW: yaw.with_values(turned_back)}), [finding]


def _resultant(angle: Array, weight: Array) -> float:
    return float(np.abs((weight * np.exp(1j * angle)).sum()) / weight.sum())


def _other_rates(log: MeasuredLog, robot: RobotParameters) -> list[Array]:
    """Return the turn rates by gyro and wheels."""
    windows, rates = windows_of(log), []
    if GYRO in log:
        rates.append(mean_in(log[GYRO], windows))
    wheels = turned(log, windows, robot)
    return rates if wheels is None else [*rates, wheels]


def _wheels_by_navigation(log: MeasuredLog, robot: RobotParameters) -> Found:
    """Judge wheels by the tag: w = a v + b om, with a > 0 on the left and < 0 on the right.

    On a mecanum robot, which also moves sideways, both wheels of a side are taken together.
    """
    found = _forward(log) if _is_aligned(log, robot) else None
    kinds = [
        k for k in ("speed_rpm", "setpoint_rpm", "duty_pct") if f"wheel.fl.{k}" in log
    ]
    if found is None or not kinds:
        return log, []
    windows = windows_of(log)
    own = (
        SIDES
        if robot.is_mecanum
        else [(w,) for w in WHEELS if f"wheel.{w}.{kinds[0]}" in log]
    )
    signs: dict[tuple[str, ...], tuple[float, float]] = {}
    for wheels in own:
        w = side_mean(log, wheels, kinds[0], windows)
        fit = None if w is None else _two_weights(w * robot.wheel_radius_m, *found)
        if fit is None or abs(fit[0]) < 0.2 or abs(fit[1]) < 0.02:
            continue  # it does not follow: it is at rest, or not connected
        forward = 1.0 if wheels[0] in LEFT_WHEELS else -1.0
        signs[wheels] = forward * np.sign(fit[0]), robot.yaw_sign * np.sign(fit[1])
    both = len({wheels[0] in LEFT_WHEELS for wheels in signs}) == 2
    if both and set(signs.values()) == {(-1.0, 1.0)}:
        text = (
            "they roll backward where the tag, unless mounted backward, moves forward"
        )
        return _swapped(log, kinds, dict.fromkeys(kinds, 1.0), text)
    names = [f"wheel.{w}.{kind}" for wheels, sign in signs.items() if sign == (-1.0, -1.0)
             for w in wheels for kind in kinds]  # fmt: skip
    against = [name for name in names if name in log]
    if not against:
        return log, []
    return _flipped(
        log, against, 0.99, "the wheels roll opposite to the motion measured by the tag"
    )


def _is_aligned(log: MeasuredLog, robot: RobotParameters) -> bool:
    """Return whether the heading lies along the course, forward or backward."""
    found = _course(log, robot)
    if found is None or len(found.course) < FEWEST_PIECES:
        return False
    course, yaw, speed, _ = found
    return bool(
        abs(np.angle((speed * np.exp(2j * (course - yaw))).sum()))
        < 2.0 * LARGEST_SKEW_RAD
    )


def _forward(log: MeasuredLog) -> tuple[Array, Array] | None:
    """Return speed along the heading and turn rate in each window, by the tag."""
    moved = _moved(log)
    if moved is None:
        return None
    dx, dy, dt, cosine, sine = moved
    return (dx * cosine + dy * sine) / dt, rate_in(log[YAW], windows_of(log))


def _turning(log: MeasuredLog, robot: RobotParameters) -> Found:
    """Judge the rest: which one turns against the others."""
    windows = windows_of(log)
    wheels = turned(log, windows, robot)
    gyro = mean_in(log[GYRO], windows) if GYRO in log else None
    yaw = rate_in(log[YAW], windows) if YAW in log else None
    by_wheels = {
        name: _against(rate, wheels) for name, rate in ((GYRO, gyro), (YAW, yaw))
    }
    between = _against(gyro, yaw)
    if by_wheels[GYRO] and by_wheels[YAW]:
        world = [n for n in (NAV_Y, YAW, GYRO, IMU_YAW) if n in log]
        return _flipped(
            log, world, 0.99, "the yaw of the base runs opposite to the measurement"
        )
    if by_wheels[GYRO] and (yaw is None or between):
        return _flipped(log, [GYRO], 0.99, "the gyro turns opposite to the wheels")
    if by_wheels[YAW] and (gyro is None or between):
        world = [n for n in (NAV_Y, YAW) if n in log]
        return _flipped(
            log, world, 0.99, "the yaw of the base runs opposite to the measurement"
        )
    if wheels is None and between:
        return _flipped(log, [GYRO], 0.99, "the gyro turns opposite to the heading")
    return log, []


def _against(rate: Array | None, other: Array | None) -> bool:
    """Return whether two turn rates clearly have opposite signs."""
    found: Line | None = line(rate, other, SLOWEST_TURN_RAD_S)
    return (
        found is not None
        and found.n >= FEWEST_PIECES
        and found.correlation < -SIGN_SURE
    )
