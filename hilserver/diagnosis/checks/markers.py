"""Values that stand for a sample that is missing: they are no readings and are left out."""

from dataclasses import replace

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.checks.support import listed, measured_channels, subset
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    FEWEST_CHANGES,
    FEWEST_EVENTS,
    HALF,
    UNITY,
    ZERO_LEAST_M,
)
from hilserver.measured.channels import POSITION, TAG
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

Stretch = tuple[int, float, float]
"""A span of the log, and the stamps of the first and last sample in it [s]."""


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Leave out markers; no fault of what was measured: notices name them."""
    for name in (
        n for n in measured_channels(log.channels) if not n.endswith("duty_pct")
    ):
        value = far_value(log[name].values)
        if value is not None:
            log = _without(log, {name: log[name].values == value}, f"{value:.10g}")
    fastest_m_s = 2.0 * robot.wheel_radius_m * robot.max_rpm * RAD_S_PER_RPM
    stretches = _zeros(log, fastest_m_s)
    gone = {name: _zero_in(log[name], stretches) for name in TAG if name in log}
    if any(marked.sum() >= FEWEST_EVENTS for marked in gone.values()):
        log = _without(log, gone, "0")
    return log, []


def far_value(values: Array) -> float | None:
    """Return the value that comes again and is much farther from all others than they span."""
    different, counts = np.unique(values, return_counts=True)
    if len(different) < FEWEST_CHANGES:
        return None
    for end, rest in ((0, different[1:]), (-1, different[:-1])):
        gap = float(np.abs(rest - different[end]).min())
        if gap > UNITY * (rest[-1] - rest[0]) and FEWEST_EVENTS <= counts[
            end
        ] < HALF * len(values):
            return float(different[end])
    return None


def _zeros(log: MeasuredLog, fastest_m_s: float) -> list[Stretch]:
    """Return where the position stands at zero and no wheels have driven to it."""
    found: list[Stretch] = []
    for index in range(len(log.spans) if log.has(*POSITION) else 0):
        (t_x, x), (t_y, y) = (log[name].of(index) for name in POSITION)
        t_s, in_x, in_y = np.intersect1d(
            t_x, t_y, assume_unique=True, return_indices=True
        )
        far_m = np.hypot(x[in_x], y[in_y])
        borders = np.flatnonzero(np.diff(far_m == 0.0, prepend=False, append=False))
        for first, end in borders.reshape(-1, 2).tolist():
            if first == 0 or end == len(t_s):
                continue  # poses of a segment often begin at zero
            took_s = t_s[[first, end]] - t_s[[first - 1, end - 1]]
            if (far_m[[first - 1, end]] > ZERO_LEAST_M + fastest_m_s * took_s).all():
                found.append((index, float(t_s[first]), float(t_s[end - 1])))
    return found


def _zero_in(channel: Channel, stretches: list[Stretch]) -> Mask:
    """Return which samples are zero in one of the stretches, shape (n,)."""
    found = np.zeros(len(channel), dtype=np.bool_)
    for index, begin_s, end_s in stretches:
        found |= (
            (channel.span == index) & (begin_s <= channel.t_s) & (channel.t_s <= end_s)
        )
    return np.asarray(found & (channel.values == 0.0))


def _without(log: MeasuredLog, gone: dict[str, Mask], value: str) -> MeasuredLog:
    left = {
        name: subset(log[name], ~marked)
        for name, marked in gone.items()
        if marked.any() and not marked.all()
    }
    note = (
        f"{listed(list(left))}: {value} marks a missing sample,"
        f" {max(int(marked.sum()) for marked in gone.values())} times; these were left out:"
        " leave such fields empty"
    )
    return replace(log.with_channels(left), notices=(*log.notices, note))
