"""Unit errors: a channel is larger or smaller than all others by the factor of a unit."""

from collections.abc import Iterable
from dataclasses import replace
from itertools import product
from typing import Final

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
from hilserver.diagnosis.checks.support import data_fault, largest, listed, reach
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    UNIT_ALIKE,
    UNIT_CLOSE,
    UNIT_CLOSE_WHEEL,
    UNIT_OTHER_AXIS,
    UNITY,
)
from hilserver.measured.channels import GYRO, IMU_YAW, POSITION, SETPOINTS, SPEEDS, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

WHEEL = {
    RAD_S_PER_RPM: "in rad/s instead of rpm",
    30.0 / np.pi: "in rpm instead of rad/s",
    6.0: "in deg/s instead of rpm",
    1.0 / 60.0: "in revolutions per second instead of rpm",
    1e-3: "a thousand times too small",
    1e3: "a thousand times too large",
}
ANGLE = {
    180.0 / np.pi: "in degrees instead of radians",
    np.pi / 180.0: "in radians instead of degrees",
    1e-3: "a thousand times too small",
    1e3: "a thousand times too large",
}
LENGTH = {
    1e3: "in millimetres instead of metres",
    1e2: "in centimetres instead of metres",
    1e-3: "a thousand times too small",
}
SHARE = {0.01: "a fraction of 1 instead of a percentage"}
M_PER_DEG: Final = 111_320.0  # of latitude; of longitude less
SAME_SIDE: Final = (SPEEDS[1], SPEEDS[0], SPEEDS[3], SPEEDS[2])


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find channels in a wrong unit, and convert them."""
    findings: list[Finding] = []
    log = _without_degrees(log, robot)
    for judge in (
        _wheels,
        _wheels,
        _wheel,
        _wheel,
        _yaw,
        _gyro,
        _position,
        _position,
        _duty,
    ):
        channels, fault = judge(log, robot)
        if fault is None:
            continue
        factor, ratio, text = fault
        log = log.with_channels(
            {
                name: log[name].with_values(log[name].values / factor)
                for name in channels
            }
        )
        findings.append(_finding(channels, factor, ratio, text))
    return log, findings


Fault = tuple[float, Line, str]


def _known(
    ratio: Line | None, factors: dict[float, str], close: float = UNIT_CLOSE
) -> Fault | None:
    """Return the factor of a unit that is near a ratio, or None."""
    if (
        ratio is None
        or abs(ratio.correlation) < UNIT_ALIKE
        or 1 / UNITY < abs(ratio.slope) < UNITY
    ):
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
        f"{listed(channels)}: {text} (factor {factor:.4g} relative to the other channels):"
        " correct the unit in the mapping; the values were converted."
    )
    return data_fault(
        "unit_error", channels, factor, (factor - half, factor + half), "1", said
    )


def _of_wheels(robot: RobotParameters) -> dict[float, str]:
    """Return the units of wheel speeds, those of the rim among them."""
    rim = robot.wheel_radius_m * RAD_S_PER_RPM
    return {
        **WHEEL,
        rim: "in m/s instead of rpm",
        3.6 * rim: "in km/h instead of rpm",
    }


def _wheels(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    """Judge wheel speeds, then set-points, by each other and by the navigation."""
    speeds = _there(log, (f"wheel.{wheel}.speed_rpm" for wheel in WHEELS))
    sent = _there(log, (f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS))
    windows = windows_of(log)
    moved = _moved(log)
    travelled = None if moved is None else np.hypot(*moved)
    by_nav = {
        what: _known(
            line(rolled(log, what, windows, robot), travelled, 0.02), _of_wheels(robot)
        )
        for what in ("speed_rpm", "setpoint_rpm")
    }
    if (
        speeds
        and (fault := by_nav["speed_rpm"]) is not None
        and _near(log, fault, robot, speeds)
    ):
        return speeds, fault
    if (
        sent
        and (fault := by_nav["setpoint_rpm"]) is not None
        and _near(log, fault, robot, sent)
    ):
        return sent, fault
    pairs = [
        (mean_in(log[f"wheel.{w}.speed_rpm"], windows), mean_in(log[s], windows))
        for w in WHEELS
        if log.has(s := f"wheel.{w}.setpoint_rpm", f"wheel.{w}.speed_rpm")
    ]
    if not pairs or travelled is not None:
        return [], None
    speed, wanted = (
        np.abs(np.concatenate(column)) for column in zip(*pairs, strict=True)
    )
    fault = _known(line(speed, wanted, 1e-3), WHEEL, 1.15)
    if fault is not None and np.nanquantile(wanted, 0.99) > 2.0 * robot.max_rpm:
        factor, ratio, _ = fault
        inverse = min(WHEEL, key=lambda f: abs(float(np.log(f * factor))))
        return sent, (inverse, ratio, WHEEL[inverse])
    return speeds, fault


def _wheel(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    """Judge each wheel by its set-point, or else by the other wheel of its side.

    Of the two that one is wrong whose size differs more from the usual one of its kind.
    """
    windows, kinds = windows_of(log), (SPEEDS, SETPOINTS)
    columns = {n: mean_in(log[n], windows) for kind in kinds for n in _there(log, kind)}
    size = {}
    for name in columns:
        values = np.abs(log[name].values)
        size[name] = float(np.minimum(values, largest(values)).mean()) + 1e-9

    def apart(name: str) -> float:
        usual = np.median(
            [size[n] for kind in kinds for n in kind if name in kind and n in size]
        )
        return abs(float(np.log(size[name] / usual)))

    found: dict[str, Fault] = {}
    for speed, sent, other in zip(SPEEDS, SETPOINTS, SAME_SIDE, strict=True):
        pair = [name for name in (speed, sent, other) if name in columns][:2]
        if speed in pair and len(pair) == 2:
            right, wrong = sorted(pair, key=apart)
            fault = _known(
                line(columns[wrong], columns[right], 1e-3),
                _of_wheels(robot),
                UNIT_CLOSE_WHEEL,
            )
            found |= {} if fault is None else {wrong: fault}
    first = next(iter(found.values()), None)
    return [n for n, fault in found.items() if first and fault[0] == first[0]], first


def _near(
    log: MeasuredLog, fault: Fault, robot: RobotParameters, names: list[str]
) -> bool:
    """Return whether the robot can drive the converted speeds."""
    fastest = max(float(np.quantile(np.abs(log[name].values), 0.99)) for name in names)
    return fastest / fault[0] < 4.0 * robot.max_rpm


def _there(log: MeasuredLog, names: Iterable[str]) -> list[str]:
    return [name for name in names if name in log]


def _moved(log: MeasuredLog) -> tuple[Array, Array] | None:
    """Return how fast the tag moved along x and y [m/s]."""
    if not log.has(*POSITION):
        return None
    windows = windows_of(log)
    ends = [ends_in(log[name], windows) for name in POSITION]
    (x, y), dt = [last - first for first, last, _ in ends], ends[0][2]
    return x / dt, y / dt


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
        if name not in log or reach(log[name].values) < 4.0 * np.pi:
            continue
        rate = rate_in(log[name], windows, 360.0)
        by_wheels = turned(log, windows, robot)
        if by_wheels is None and GYRO in log:
            by_wheels = mean_in(log[GYRO], windows)
        fault = _known(line(rate, by_wheels, 0.02), ANGLE, 2.5)
        if fault is not None:
            return [name], fault
    return [], None


def _way(log: MeasuredLog, robot: RobotParameters) -> Array | None:
    """Return how fast the wheels, or else their set-points, would move the robot [m/s]."""
    speeds = rolled(log, "speed_rpm", windows_of(log), robot)
    return (
        rolled(log, "setpoint_rpm", windows_of(log), robot)
        if speeds is None
        else speeds
    )


def _without_degrees(log: MeasuredLog, robot: RobotParameters) -> MeasuredLog:
    """Leave out a position in latitude and longitude: no one factor makes metres of it."""
    moved, way = _moved(log), _way(log, robot)
    fit = None if moved is None else line(np.hypot(*moved), way, 0.02)
    if (
        fit is None
        or fit.correlation < UNIT_ALIKE
        or not 0.3 < fit.slope * M_PER_DEG < 2.0
    ):
        return log
    note = (
        f"{listed(POSITION)} are latitude and longitude in degrees and were left out: map them"
        " as fix.latitude_deg and fix.longitude_deg"
    )
    return replace(log.without(POSITION), notices=(*log.notices, note))


def _position(
    log: MeasuredLog, robot: RobotParameters
) -> tuple[list[str], Fault | None]:
    """Judge the axes: of all units that they may have, those count that fit the way best."""
    moved, way = _moved(log), _way(log, robot)
    usual = None if moved is None else line(np.hypot(*moved), way, 0.02)
    if moved is None or usual is None or 1 / UNITY < usual.slope < UNITY:
        return [], None
    fits: dict[tuple[float, float], Line] = {}
    for of_x, of_y in product((1.0, *LENGTH), repeat=2):
        fit = line(np.hypot(moved[0] / of_x, moved[1] / of_y), way, 0.02)
        if fit is not None and 0.5 < fit.slope < 2.0 and fit.correlation > UNIT_ALIKE:
            fits[of_x, of_y] = fit
    if not fits:
        return [], None
    best = min(
        fits,
        key=lambda u: (
            (1.0 - fits[u].correlation ** 2)
            * (UNIT_OTHER_AXIS if u[0] == u[1] else 1.0)
        ),
    )
    factor = max(best, key=lambda unit: abs(np.log(unit)))
    wrong = [name for name, unit in zip(POSITION, best, strict=True) if unit == factor]
    return wrong, (factor, fits[best], LENGTH[factor])


def _duty(log: MeasuredLog, robot: RobotParameters) -> tuple[list[str], Fault | None]:
    """Judge duties as shares: hardly one is above 1; the speed needs a hundred times as much."""
    names = _there(log, (f"wheel.{wheel}.duty_pct" for wheel in WHEELS))
    windows = windows_of(log)
    pairs = [
        (mean_in(log[n], windows), mean_in(log[s], windows) / robot.process.gain)
        for n in names
        if (s := n.replace("duty_pct", "speed_rpm")) in log
    ]
    if not pairs or max(largest(log[n].values) for n in names) > 1.01:
        return [], None
    duty, wanted = (np.concatenate(column) for column in zip(*pairs, strict=True))
    return names, _known(line(duty, wanted, 1.0), SHARE, 2.5)
