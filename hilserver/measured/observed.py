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
    sides: list[list[str]] = []
    for side in (SPEEDS[:N_LEFT], SPEEDS[N_LEFT:]):
        there = [name for name in side if name in log]
        if not there:
            raise LogError(
                f"{log.sources[0].file}: contains no speed for the wheels {', '.join(side)}; the"
                " observer needs both sides: map their columns"
            )
        if robot.is_mecanum and len(there) < len(side):
            raise LogError(
                f"{log.sources[0].file}: contains only the speed of {there[0]} of the wheels"
                f" {', '.join(side)}; mecanum wheels move the robot sideways: map all columns"
            )
        sides.append(there)
    stamps = [log[name].of(span)[0] for name in (*sides[0], *sides[1])]
    times = stamps[0]
    for other in stamps[1:]:
        common = np.intersect1d(times, other)
        times = common if len(common) else times
    both = [
        RAD_S_PER_RPM
        * np.array([np.interp(times, *log[name].of(span)) for name in side])
        for side in sides
    ]
    (left, right), apart = (
        [side.mean(axis=0) for side in both],
        [s[0] - s[-1] for s in both],
    )
    turned = np.concatenate(
        [[0.0], np.cumsum(0.5 * np.diff(times) * (left[1:] + left[:-1]))]
    )
    samples = _samples(log, span, robot, nav_late_s)
    return MeasuredSeries(
        np.column_stack([times, left, right, turned, *apart]), samples
    )


def _samples(
    log: MeasuredLog, span: int, robot: RobotParameters, nav_late_s: float
) -> Array:
    nav = robot.nav
    rows = [np.zeros((0, 4))]
    if GYRO_CHANNEL in log:
        t, rate = log[GYRO_CHANNEL].of(span)
        rows.append(_rows(GYRO, t - _term(robot, "imu_latency"), rate))
    if log.has(*PLACE):
        (t, x), (t_y, y) = (log[name].of(span) for name in PLACE)
        both, of_x, of_y = np.intersect1d(t, t_y, return_indices=True)
        late = nav_late_s + nav.latency_s + _term(robot, "nav_latency")
        rows.append(_rows(POSITION, both - late, x[of_x], y[of_y]))
    if YAW in log:
        t, yaw = log[YAW].of(span)
        late = nav_late_s + nav.yaw_latency_s + _term(robot, "yaw_latency")
        rows.append(_rows(HEADING, t - late, yaw))
    samples = np.concatenate(rows)
    return samples[np.argsort(samples[:, 1], kind="stable")]


def _rows(kind: int, t: Array, first: Array, second: Array | float = 0.0) -> Array:
    return np.column_stack(
        [np.full(len(t), float(kind)), t, first, np.broadcast_to(second, len(t))]
    )


def _term(robot: RobotParameters, name: str) -> float:
    value = robot.terms.get(name, TERMS[name].null)
    return 0.0 if value is None else value
