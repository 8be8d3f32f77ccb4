"""Measured data as the observer takes it: wheels as moments, samples at the time they are true."""

import numpy as np

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.measured.channels import GYRO as GYRO_CHANNEL
from hilserver.measured.channels import POSITION as PLACE
from hilserver.measured.channels import SPEEDS, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.observer.offline import GYRO, HEADING, POSITION, MeasuredSeries
from hilserver.plant.layout import LEFT_WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import TERMS
from hilserver.plant.units import RAD_S_PER_RPM

N_LEFT = len(LEFT_WHEELS)


def series_of(
    log: MeasuredLog, span: int, robot: RobotParameters, nav_late_s: float = 0.0
) -> MeasuredSeries:
    """Return one span of a log.

    A moment is a stamp at which every measured wheel has a sample.

    Parameters
    ----------
    nav_late_s : float
        By how much the stamps of the navigation are late compared with those of the wheels.
    """
    file, number = log.sources[0].file, log.spans[span].number
    sides: list[list[str]] = []
    for side in (SPEEDS[:N_LEFT], SPEEDS[N_LEFT:]):
        recorded = [name for name in side if name in log]
        if not recorded:
            raise LogError(
                f"{file}: contains no speed for the wheels {', '.join(side)}; the"
                " observer needs both sides: map their columns"
            )
        there = [name for name in recorded if len(log[name].of(span)[0])]
        if not there:
            raise LogError(
                f"{file}: segment {number} contains no sample of {', '.join(recorded)};"
                " the observer needs both sides: leave the segment out"
            )
        if robot.is_mecanum and len(there) < len(side):
            raise LogError(
                f"{file}: segment {number} contains only the speed of {there[0]} of the wheels"
                f" {', '.join(side)}; mecanum wheels move the robot sideways: map all columns"
            )
        sides.append(there)
    times, *others = [log[name].of(span)[0] for name in (*sides[0], *sides[1])]
    for other in others:
        common = np.intersect1d(times, other)
        times = common if len(common) else times

    means = []
    apart = []
    for names in sides:
        rpm = [np.interp(times, *log[name].of(span)) for name in names]
        speeds = RAD_S_PER_RPM * np.array(rpm)
        means.append(speeds.mean(axis=0))
        apart.append(speeds[0] - speeds[-1])
    left, right = means
    twice = left[1:] + left[:-1]
    turned = np.append(0.0, np.cumsum(0.5 * np.diff(times) * twice))
    moments = np.column_stack([times, left, right, turned, *apart])
    return MeasuredSeries(moments, _samples(log, span, robot, nav_late_s))


def _samples(
    log: MeasuredLog, span: int, robot: RobotParameters, nav_late_s: float
) -> Array:
    """Return what gyro and navigation measured, in the order in which it was true."""
    samples = [np.zeros((0, 4))]
    if GYRO_CHANNEL in log:
        t, rate = log[GYRO_CHANNEL].of(span)
        samples.append(_rows(GYRO, t - _term(robot, "imu_latency"), rate))
    if log.has(*PLACE):
        (t, x), (t_y, y) = (log[name].of(span) for name in PLACE)
        both, of_x, of_y = np.intersect1d(t, t_y, return_indices=True)
        late = nav_late_s + robot.nav.latency_s + _term(robot, "nav_latency")
        samples.append(_rows(POSITION, both - late, x[of_x], y[of_y]))
    if YAW in log:
        t, yaw = log[YAW].of(span)
        late = nav_late_s + robot.nav.yaw_latency_s + _term(robot, "yaw_latency")
        samples.append(_rows(HEADING, t - late, yaw))
    rows = np.concatenate(samples)
    return rows[np.argsort(rows[:, 1], kind="stable")]


def _rows(kind: int, t: Array, first: Array, second: Array | float = 0.0) -> Array:
    kinds = np.full(len(t), float(kind))
    seconds = np.broadcast_to(second, len(t))
    return np.column_stack([kinds, t, first, seconds])


def _term(robot: RobotParameters, name: str) -> float:
    value = robot.terms.get(name, TERMS[name].null)
    return 0.0 if value is None else value
