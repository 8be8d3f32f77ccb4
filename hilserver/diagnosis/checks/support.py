"""Shared by the checks."""

from collections.abc import Iterable, Sequence
from dataclasses import replace

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.schema.findings import Finding, Interval, Parameter, Verdict
from hilserver.diagnosis.thresholds import STILL_RPM
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
        channel, t_s=channel.t_s[keep], values=channel.values[keep], span=channel.span[keep]
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


def standing(log: MeasuredLog, source: Channel) -> Mask:
    """Return at which samples of a source no wheel is asked to turn, and none turns."""
    at, moves = along(source), np.zeros(len(source), dtype=bool)
    known = [log[name] for name in (*SETPOINTS, *SPEEDS) if name in log and len(log[name])]
    for channel in known:
        last = np.searchsorted(along(channel), at, side="right") - 1
        moves |= np.abs(channel.values[np.maximum(last, 0)]) > STILL_RPM
    return ~moves & bool(known)
