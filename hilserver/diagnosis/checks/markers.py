"""Values that stand for a sample that is missing: they are no readings and are left out."""

from dataclasses import replace
from typing import Final

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.checks.support import listed, measured_channels, subset
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import FEWEST_CHANGES, FEWEST_EVENTS, HALF, UNITY
from hilserver.measured.channels import POSITION, TAG
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM

LEAST_M: Final = 0.3  # m beside what the wheels can drive: more than a tag's own jumps


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Leave out markers; no fault of what was measured: notices name them."""
    for name in (n for n in measured_channels(log.channels) if not n.endswith("duty_pct")):
        value = far_value(log[name].values)
        if value is not None:
            log = _without(log, {name: log[name].values == value}, f"{value:.10g}")
    fastest_m_s = 2.0 * robot.wheel_radius_m * robot.max_rpm * RAD_S_PER_RPM
    at = _zeros(log, fastest_m_s)
    if len(at) >= FEWEST_EVENTS:
        gone = {n: _stand_at(log[n], at) & (log[n].values == 0.0) for n in TAG if n in log}
        log = _without(log, gone, "0")
    return log, []


def far_value(values: Array) -> float | None:
    """Return the value that comes again and is much farther from all others than they span."""
    different, counts = np.unique(values, return_counts=True)
    if len(different) < FEWEST_CHANGES:
        return None
    for end, rest in ((0, different[1:]), (-1, different[:-1])):
        gap = float(np.abs(rest - different[end]).min())
        if gap > UNITY * (rest[-1] - rest[0]) and FEWEST_EVENTS <= counts[end] < HALF * len(values):
            return float(different[end])
    return None


def _zeros(log: MeasuredLog, fastest_m_s: float) -> Array:
    """Return span and stamp of positions at zero that no wheels have driven to, shape (n, 2)."""
    found = [np.empty((0, 2))]
    for index in range(len(log.spans) if log.has(*POSITION) else 0):
        (t_x, x), (t_y, y) = (log[name].of(index) for name in POSITION)
        t_s, in_x, in_y = np.intersect1d(t_x, t_y, assume_unique=True, return_indices=True)
        far_m = np.hypot(x[in_x], y[in_y])
        borders = np.flatnonzero(np.diff(far_m == 0.0, prepend=False, append=False))
        for first, end in borders.reshape(-1, 2).tolist():
            beside = [b for b in (first - 1, end) if 0 <= b < len(t_s)]
            if len(beside) == 2:
                took_s = t_s[[first, end]] - t_s[[first - 1, end - 1]]
            else:  # a robot may have begun or ended there
                took_s = np.full(len(beside), t_s[end - 1] - t_s[first])
            if beside and (far_m[beside] > LEAST_M + fastest_m_s * took_s).all():
                stamps = t_s[first:end]
                found.append(np.column_stack([np.full(len(stamps), index), stamps]))
    return np.concatenate(found)


def _stand_at(channel: Channel, at: Array) -> Mask:
    """Return which samples have one of these spans and stamps, shape (n,)."""
    found = np.zeros(len(channel), dtype=np.bool_)
    for index in np.unique(at[:, 0]):
        of_span = channel.span == index
        found[of_span] = np.isin(channel.t_s[of_span], at[at[:, 0] == index, 1])
    return found


def _without(log: MeasuredLog, gone: dict[str, Mask], value: str) -> MeasuredLog:
    left = {name: subset(log[name], ~marked) for name, marked in gone.items() if marked.any()}
    note = (
        f"{listed(list(left))}: {value} stands for a sample that is missing,"
        f" {max(int(marked.sum()) for marked in gone.values())} times; they were left out: leave"
        " such fields empty"
    )
    return replace(log.with_channels(left), notices=(*log.notices, note))
