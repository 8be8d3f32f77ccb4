"""Shared by the checks."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.schema.findings import Finding, Interval, Parameter, Verdict
from hilserver.diagnosis.thresholds import NEGLIGIBLE, STILL_RPM
from hilserver.measured.channels import SETPOINTS, SPEEDS
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.measured.names import is_input

SPAN_S = 1e6  # longer than any span, so that the stamps of two spans differ


def data_fault(
    cause: str,
    channels: Iterable[str],
    value: float,
    ci95: Interval | None,
    unit: str,
    explanation: str,
) -> Finding:
    """Return the finding of one fault of the log."""
    return Finding(
        verdict=Verdict.DATA_FAULT,
        causes=(cause,),
        block="data",
        parameters={cause: Parameter(value=value, ci95=ci95, unit=unit)},
        explanation=explanation,
        regressors=tuple(channels),
    )


def listed(names: Sequence[str]) -> str:
    """Return names for a technician, long lists shortened."""
    if len(names) <= 4:
        return ", ".join(names)
    return f"{', '.join(names[:3])} and {len(names) - 3} more"


def measured_channels(channels: Iterable[str]) -> list[str]:
    """Return the channels that are measured, not commanded."""
    return [name for name in channels if not is_input(name)]


def subset(channel: Channel, keep: Mask) -> Channel:
    """Return the channel with some of its samples."""
    return replace(
        channel,
        t_s=channel.t_s[keep],
        values=channel.values[keep],
        span=channel.span[keep],
    )


def along(channel: Channel, start_s: Array | None = None) -> Array:
    """Return stamps that rise over all spans, [s].

    Parameters
    ----------
    start_s : ndarray, shape (spans,), optional
        Stamps are counted from these; needed if stamps may be seconds since some epoch, and a later
        span an earlier day.
    """
    since = channel.t_s if start_s is None else channel.t_s - start_s[channel.span]
    result: Array = since + SPAN_S * channel.span
    return result


def row_period_s(channel: Channel) -> float:
    """Return the usual time between two samples; 0 if there are too few."""
    steps = np.diff(channel.t_s)[np.diff(channel.span) == 0]
    return float(np.median(steps)) if len(steps) else 0.0


def slope_of(y: Array, x: Array) -> float:
    """Return the slope of y = slope x that least absolute errors give; 0 if x is zero throughout.

    It is the median of all y / x, each counted with its |x|: while less than half of that is wild,
    no wild value moves it far.
    """
    moves = x != 0.0
    if not moves.any():
        return 0.0
    ratio = y[moves] / x[moves]
    order = np.argsort(ratio)
    weight = np.cumsum(np.abs(x[moves])[order])
    return float(ratio[order][np.searchsorted(weight, 0.5 * weight[-1])])


def largest(values: Array) -> float:
    """Return the largest size of a reading, a few wild ones left out; 0 without any."""
    return float(np.quantile(np.abs(values), 1.0 - NEGLIGIBLE)) if len(values) else 0.0


def reach(values: Array) -> float:
    """Return the range of the readings, a few wild ones left out; 0 without any."""
    if not len(values):
        return 0.0
    low, high = np.quantile(values, [0.5 * NEGLIGIBLE, 1.0 - 0.5 * NEGLIGIBLE])
    return float(high - low)


def standing(log: MeasuredLog, source: Channel) -> Mask:
    """Return at which samples of a source no wheel is asked to turn, and none turns."""
    at, moves = along(source), np.zeros(len(source), dtype=bool)
    known = [
        log[name] for name in (*SETPOINTS, *SPEEDS) if name in log and len(log[name])
    ]
    for channel in known:
        last = np.searchsorted(along(channel), at, side="right") - 1
        moves |= np.abs(channel.values[np.maximum(last, 0)]) > STILL_RPM
    return ~moves & bool(known)
