"""Unit errors: a channel is larger or smaller than all others by the factor of a unit."""

from collections.abc import Iterable

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.motion import (
    Line,
    ends_in,
    line,
    mean_in,
    rate_in,
    rolled,
    turned,
    windows_of,
)
from hilserver.diagnosis.checks.support import data_fault, listed
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import UNIT_ALIKE, UNIT_CLOSE, UNITY
from hilserver.measured.channels import GYRO, IMU_YAW, NAV_X, NAV_Y, POSITION, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

WHEEL = {
    RAD_S_PER_RPM: "holds rad/s where rpm is meant",
    30.0 / np.pi: "holds rpm where rad/s is meant",
    6.0: "holds deg/s where rpm is meant",
    1.0 / 60.0: "holds turns per second where turns per minute are meant",
    1e-3: "is a thousand times too small",
    1e3: "is a thousand times too large",
}
ANGLE = {
    180.0 / np.pi: "holds degrees where radians are meant",
    np.pi / 180.0: "holds radians where degrees are meant",
    1e-3: "is a thousand times too small",
    1e3: "is a thousand times too large",
}
LENGTH = {
    1e3: "holds millimetres where metres are meant",
    1e2: "holds centimetres where metres are meant",
    1e-3: "is a thousand times too small",
}
SHARE = {0.01: "holds a share of 1 where per cent is meant"}


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find channels in a wrong unit, and convert them."""
    findings: list[Finding] = []
    for judge in (_wheels, _wheels, _yaw, _gyro, _position, _duty):
        channels, fault = judge(log, robot)
        if fault is None:
            continue
        factor, ratio, text = fault
        log = log.with_channels(
            {name: log[name].with_values(log[name].values / factor) for name in channels}
        )
        findings.append(_finding(channels, factor, ratio, text))
    return log, findings


Fault = tuple[float, Line, str]


def _known(
    ratio: Line | None, factors: dict[float, str], close: float = UNIT_CLOSE
) -> Fault | None:
    """Return the factor of a unit that is near a ratio, or None."""
    if ratio is None or abs(ratio.correlation) < UNIT_ALIKE or 1 / UNITY < abs(ratio.slope) < UNITY:
        return None
    size = abs(ratio.slope)
    factor = min(factors, key=lambda f: abs(float(np.log(size / f))))
    if abs(np.log(size / factor)) > np.log(close):
        return None
    return factor, ratio, factors[factor]


def _finding(channels: list[str], factor: float, ratio: Line, text: str) -> Finding:
    half = 1.96 * abs(factor) * np.sqrt(1 / ratio.correlation**2 - 1) / np.sqrt(ratio.n)
    half = max(float(half), 0.02 * factor)
    said = (
        f"{listed(channels)} {text} (factor {factor:.4g} against the other channels): correct the"
        " unit in the mapping; it was converted."
    )
    return data_fault("unit_error", channels, factor, (factor - half, factor + half), "1", said)


def _wheels(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    """Judge wheel speeds, then set-points, by each other and by the navigation."""
    speeds = _there(log, (f"wheel.{wheel}.speed_rpm" for wheel in WHEELS))
    sent = _there(log, (f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS))
    windows = windows_of(log)
    travelled = _chord(log)
    by_nav = {
        what: _known(line(rolled(log, what, windows, robot), travelled, 0.02), WHEEL)
        for what in ("speed_rpm", "setpoint_rpm")
    }
    if speeds and (fault := by_nav["speed_rpm"]) is not None and _near(log, fault, robot, speeds):
        return speeds, fault
    if sent and (fault := by_nav["setpoint_rpm"]) is not None and _near(log, fault, robot, sent):
        return sent, fault
    pairs = [
        (mean_in(log[f"wheel.{w}.speed_rpm"], windows), mean_in(log[s], windows))
        for w in WHEELS
        if log.has(s := f"wheel.{w}.setpoint_rpm", f"wheel.{w}.speed_rpm")
    ]
    if not pairs or travelled is not None:
        return [], None
    speed, wanted = (np.abs(np.concatenate(column)) for column in zip(*pairs, strict=True))
    fault = _known(line(speed, wanted, 1e-3), WHEEL, 1.15)
    if fault is not None and np.nanquantile(wanted, 0.99) > 2.0 * robot.max_rpm:
        factor, ratio, _ = fault
        inverse = min(WHEEL, key=lambda f: abs(float(np.log(f * factor))))
        return sent, (inverse, ratio, WHEEL[inverse])
    return speeds, fault


def _near(log: MeasuredLog, fault: Fault, robot: RobotParameters, names: list[str]) -> bool:
    """Return whether the robot can drive the converted speeds."""
    fastest = max(float(np.quantile(np.abs(log[name].values), 0.99)) for name in names)
    return fastest / fault[0] < 4.0 * robot.max_rpm


def _there(log: MeasuredLog, names: Iterable[str]) -> list[str]:
    return [name for name in names if name in log]


def _chord(log: MeasuredLog) -> Array | None:
    """Return the distance per second that the tag moved [m/s]."""
    if not log.has(*POSITION):
        return None
    windows = windows_of(log)
    x0, x1, dt = ends_in(log[NAV_X], windows)
    y0, y1, _ = ends_in(log[NAV_Y], windows)
    result: Array = np.hypot(x1 - x0, y1 - y0) / dt
    return result


def _gyro(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    name, windows = GYRO, windows_of(log)
    if name not in log:
        return [], None
    gyro = mean_in(log[name], windows)
    if YAW in log:
        fault = _known(line(gyro, rate_in(log[YAW], windows), 0.02), ANGLE, 1.5)
    else:
        fault = _known(line(gyro, turned(log, windows, robot), 0.02), ANGLE, 2.2)
    return [name], fault


def _yaw(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    """Judge headings in degrees: in radians, successive rows never differ that much."""
    windows = windows_of(log)
    for name in (YAW, IMU_YAW):
        if name not in log or np.ptp(log[name].values) < 4.0 * np.pi:
            continue
        rate = rate_in(log[name], windows, 360.0)
        by_wheels = turned(log, windows, robot)
        if by_wheels is None and GYRO in log:
            by_wheels = mean_in(log[GYRO], windows)
        fault = _known(line(rate, by_wheels, 0.02), ANGLE, 2.5)
        if fault is not None:
            return [name], fault
    return [], None


def _position(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    windows, way = windows_of(log), None
    for what in ("speed_rpm", "setpoint_rpm"):
        way = rolled(log, what, windows, robot) if way is None else way
    fault = _known(line(_chord(log), way, 0.02), LENGTH, 2.0)
    return _there(log, POSITION), fault


def _duty(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    """Judge duties as shares: none is above 1, and the speed needs a hundred times as much."""
    names = _there(log, (f"wheel.{wheel}.duty_pct" for wheel in WHEELS))
    windows = windows_of(log)
    pairs = [
        (mean_in(log[n], windows), mean_in(log[s], windows) / robot.process.gain)
        for n in names
        if (s := n.replace("duty_pct", "speed_rpm")) in log
    ]
    if not pairs or max(float(np.abs(log[n].values).max()) for n in names) > 1.01:
        return [], None
    duty, wanted = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return names, _known(line(duty, wanted, 1.0), SHARE, 2.5)
