"""What the checks share."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.schema.findings import Finding, Interval, Parameter, Verdict
from hilserver.diagnosis.thresholds import ALTERNATING
from hilserver.measured.arrays import Array
from hilserver.measured.data import Channel
from hilserver.measured.names import is_input

SPAN_S = 1e6
"""Longer than any span; tells the stamps of two spans apart."""


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
    """Return names as a technician reads them, the long lists cut."""
    if len(names) <= 4:
        return ", ".join(names)
    return f"{', '.join(names[:3])} and {len(names) - 3} more"


def measured_channels(channels: Iterable[str]) -> list[str]:
    """Return the channels that are measured, not commanded."""
    return [name for name in channels if not is_input(name)]


def subset(channel: Channel, keep: NDArray[np.bool_]) -> Channel:
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
        Counted from these; needed where stamps may be seconds since some epoch, and a later span
        an earlier day.
    """
    since = channel.t_s if start_s is None else channel.t_s - start_s[channel.span]
    result: Array = since + SPAN_S * channel.span
    return result


@dataclass(frozen=True, slots=True)
class Runs:
    """Runs of equal values in a channel.

    Attributes
    ----------
    first : ndarray of int64, shape (n,)
        Index of each run's first sample.
    length : ndarray of int64, shape (n,)
    before, after : ndarray of float64, shape (n,)
        Step into and out of the run, absolute; 0 at the borders of a span.
    duration_s : ndarray of float64, shape (n,)
        From its first sample to the first one of the next run; NaN at the end of a span.
    """

    first: NDArray[np.int64]
    length: NDArray[np.int64]
    before: Array
    after: Array
    duration_s: Array


def runs_of(channel: Channel) -> Runs:
    """Return the runs of equal values."""
    n = len(channel)
    same_span = np.diff(channel.span) == 0
    step = np.abs(np.diff(channel.values))
    first = np.concatenate(([0], np.flatnonzero(~same_span | (step > 0)) + 1))
    steps = np.concatenate(([0.0], np.where(same_span, step, 0.0), [0.0]))
    next_first = np.append(first[1:], n)
    duration = np.full(len(first), np.nan)
    inside = next_first < n
    inside[inside] = channel.span[next_first[inside]] == channel.span[first[inside]]
    duration[inside] = channel.t_s[next_first[inside]] - channel.t_s[first[inside]]
    return Runs(first, next_first - first, steps[first], steps[next_first], duration)


def alternates(steps: Array) -> bool:
    """Return whether steps go up and down as those of a noisy channel do."""
    return len(steps) > 1 and float(np.mean(steps[1:] * steps[:-1] < 0.0)) >= ALTERNATING


def row_period_s(channel: Channel) -> float:
    """Return the usual time between two samples; 0 where there are too few."""
    steps = np.diff(channel.t_s)[np.diff(channel.span) == 0]
    return float(np.median(steps)) if len(steps) else 0.0


def resolution(values: Array) -> float:
    """Return the smallest step between two different values; 0 for a constant."""
    steps = np.diff(np.unique(values))
    return float(steps.min()) if len(steps) else 0.0
