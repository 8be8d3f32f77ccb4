"""Interpolated set-points: slower ones joined by straight lines in the recording.

The robot got stairs, the log shows ramps. Their corners lie on the slower clock: the pieces of
constant slope last one of its periods, or a whole number of them.
"""

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.checks.support import data_fault, row_period_s, subset
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    COMMAND_SLOWEST_S,
    FEWEST_PIECES,
    NEARLY_ALL,
    SAME,
)
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters

Ints = NDArray[np.int64]


def find(log: MeasuredLog, _robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find interpolated set-points; only the samples at their corners are kept, to be held."""
    names = [f"wheel.{wheel}.setpoint_rpm" for wheel in WHEELS]
    names += ["twist.linear_m_s", "twist.angular_rad_s"]
    kept: dict[str, Channel] = {}
    rates: list[float] = []
    for name in (name for name in names if name in log):
        channel = log[name]
        found = _period_rows(channel)
        if found is None:
            continue
        rows, corners = found
        kept[name] = subset(channel, _on_clock(channel, rows, corners))
        rates.append(1.0 / (rows * row_period_s(channel)))
    if not kept:
        return log, []
    rate_hz = float(np.median(rates))
    finding = data_fault(
        "interpolated_setpoint",
        kept,
        rate_hz,
        (0.98 * rate_hz, 1.02 * rate_hz),
        "Hz",
        f"The set-points were sent at {rate_hz:.3g} Hz and joined by straight lines in the log,"
        " which the robot never saw: record them as they were sent; they were taken as steps.",
    )
    return log.with_channels(kept), [finding]


def _pieces(channel: Channel) -> tuple[Ints, NDArray[np.float64]]:
    """Return first sample and slope of every piece of constant slope."""
    dt = np.diff(channel.t_s)
    inside = (np.diff(channel.span) == 0) & (dt > 0)
    slope = np.where(inside, np.diff(channel.values) / np.where(inside, dt, 1.0), np.nan)
    size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
    moving = np.abs(slope[np.nan_to_num(slope) != 0])
    least = SAME * float(np.median(moving)) if len(moving) else 0.0
    bends = ~(np.abs(np.diff(slope)) <= SAME * size + 0.1 * least)
    first = np.concatenate(([0], np.flatnonzero(bends) + 1))
    return first, slope[first]


def _period_rows(channel: Channel) -> tuple[int, Ints] | None:
    """Return the slower clock's period in samples and the corners; None if there is none."""
    row_s = row_period_s(channel)
    if len(channel) < 100 or row_s <= 0:
        return None
    first, slope = _pieces(channel)
    length = np.diff(first, append=len(channel) - 1)
    whole = np.isfinite(slope)
    whole[1:] &= whole[:-1]  # the first piece of a span begins anywhere
    whole[:-1] &= np.isfinite(slope[1:])
    sloped = whole & (slope != 0)
    if sloped.sum() < FEWEST_PIECES:
        return None
    lengths, counts = np.unique(length[sloped], return_counts=True)
    rows = int(lengths[np.argmax(counts)])
    if rows < 2 or rows * row_s > COMMAND_SLOWEST_S or counts.max() < FEWEST_PIECES:
        return None
    multiple = np.mean(length[sloped] % rows == 0)
    if multiple < NEARLY_ALL or counts.max() < 0.3 * sloped.sum():
        return None
    return rows, first[sloped]


def _on_clock(channel: Channel, rows: int, corners: Ints) -> NDArray[np.bool_]:
    """Return which samples the slower clock sent: those a whole number of periods from a corner."""
    index = np.arange(len(channel))
    before = np.clip(np.searchsorted(corners, index, side="right") - 1, 0, None)
    keep: NDArray[np.bool_] = (index - corners[before]) % rows == 0
    begins = np.diff(channel.span, prepend=-1) != 0
    return np.asarray(keep | begins)
