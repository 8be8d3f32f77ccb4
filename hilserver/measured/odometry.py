"""A driver's odometry as a measurement: it stands for the wheel speeds that it was made of.

Many robots publish no wheel speeds but only what their driver makes of them, with dimensions of its
own: v = r (w_R + w_L) / 2 and om = r (w_R - w_L) / b. Solved for the wheels, nothing is lost.
"""

from dataclasses import replace

import numpy as np

from hilserver.errors import LogError
from hilserver.measured.channels import ODOM_ANGULAR, ODOM_LINEAR, SPEEDS
from hilserver.measured.data import MeasuredLog
from hilserver.measured.mapping import LogMapping, OdometryMap
from hilserver.plant.units import RAD_S_PER_RPM

SPAN_S = 1e6  # longer than any span, so that the stamps of two spans differ


def with_wheels(log: MeasuredLog, mapping: LogMapping | None) -> MeasuredLog:
    """Return a log with wheel speeds of its odometry, where it has none of its own.

    Raises
    ------
    LogError
        If only one of its two speeds is there, or the wheels' dimensions are not.
    """
    there = [name for name in (ODOM_LINEAR, ODOM_ANGULAR) if name in log]
    if mapping is None or not there:
        return log
    file = log.sources[0].file
    if len(there) == 1:
        (missing,) = {ODOM_LINEAR, ODOM_ANGULAR} - set(there)
        raise LogError(
            f"{file}: odometry needs {missing} beside {there[0]}; map it, too"
        )
    bare = log.without(there)
    if any(name in log for name in SPEEDS):
        return replace(
            bare, notices=(*log.notices, "the odometry is not used beside wheel speeds")
        )

    radius_m, track_m, unknown = _dimensions(mapping.odom, log, file)
    linear = log[ODOM_LINEAR]
    angular = log[ODOM_ANGULAR]
    at, other = (channel.t_s + SPAN_S * channel.span for channel in (linear, angular))
    turn = np.interp(at, other, angular.values)
    half = 0.5 * track_m * turn
    m_s_per_rpm = radius_m * RAD_S_PER_RPM
    left = linear.with_values((linear.values - half) / m_s_per_rpm)
    right = linear.with_values(-(linear.values + half) / m_s_per_rpm)

    made = dict(zip(SPEEDS, (left, left, right, right), strict=True))
    note = "the wheel speeds were computed from the odometry"
    if unknown:
        note += (
            f"; {' and '.join(unknown)} of its driver is unknown, so a rotation gain or wheel"
            " radius that is found may be the driver's"
        )
    return replace(bare.with_channels(made), notices=(*log.notices, note))


def _dimensions(
    odom: OdometryMap, log: MeasuredLog, file: str
) -> tuple[float, float, list[str]]:
    """Return the driver's wheel radius and track, and which of them are only the machine's."""
    found: list[float] = []
    unknown: list[str] = []
    for key, own in (
        ("wheel_radius_m", odom.wheel_radius_m),
        ("track_m", odom.track_m),
    ):
        value = own if own is not None else log.plant.get(key)
        if not isinstance(value, float | int):
            raise LogError(
                f"{file}: wheels cannot be computed from the odometry without {key}; write"
                f" plant: {{{key}: ...}} into the mapping, and odom: {{{key}: ...}} if the driver"
                " uses another value"
            )
        found.append(float(value))
        unknown += [key] if own is None else []
    radius_m, track_m = found
    return radius_m, track_m, unknown
