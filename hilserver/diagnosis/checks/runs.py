"""Runs of a channel, stretches in which it stays the same, and how they are classified.

A classifier decides from the runs of one channel whether they are a fault of the recording, what
remains of the channel, and by how much: `repetitions` has classifiers of equal values in
measurements, `setpoint_runs` those of set-points.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.checks.support import data_fault, listed
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import ALTERNATING
from hilserver.measured.data import Channel, MeasuredLog


class RunFault(NamedTuple):
    """What a classifier finds in a channel."""

    left: Channel | None  # the real samples; None if there are none
    # rate [Hz] of the clock that the channel really has, share or delay; its standard error
    figure: float
    sd: float = 0.0


Faults = Mapping[str, RunFault]  # by channel


def classified(
    names: Iterable[str], classifier: Callable[[str], RunFault | None]
) -> dict[str, RunFault]:
    """Return the channels in which a classifier finds a fault."""
    return {name: fault for name in names if (fault := classifier(name)) is not None}


def corrected(log: MeasuredLog, faults: Faults) -> MeasuredLog:
    """Return the log with what remains of its channels."""
    left = {
        name: fault.left for name, fault in faults.items() if fault.left is not None
    }
    return log.without(faults.keys() - left.keys()).with_channels(left)


def rate_fault(cause: str, faults: Faults, text: str) -> Finding:
    """Return the finding of channels on a slower clock.

    Parameters
    ----------
    text : str
        With ``{names}`` and ``{rate_hz}``.
    """
    rate_hz, sd_hz = (float(np.median([f[k] for f in faults.values()])) for k in (1, 2))
    half = 1.96 * max(sd_hz, 0.01 * rate_hz)
    said = text.format(names=listed(list(faults)), rate_hz=f"{rate_hz:.3g}")
    return data_fault(
        cause, faults, rate_hz, (rate_hz - half, rate_hz + half), "Hz", said
    )


@dataclass(frozen=True, slots=True)
class Runs:
    """Runs of equal values in a channel."""

    first: Indices  # shape (n,): index of each run's first sample
    length: Indices  # shape (n,)
    # shape (n,): absolute step into and out of the run; 0 at the ends of a span
    before: Array
    after: Array
    # shape (n,): from its first sample to that of the next run; NaN at the end of a span
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
    """Return whether steps go up and down as in a noisy channel."""
    return (
        len(steps) > 1 and float(np.mean(steps[1:] * steps[:-1] < 0.0)) >= ALTERNATING
    )


def resolution(values: Array) -> float:
    """Return the smallest step between two different values; 0 for a constant."""
    steps = np.diff(np.unique(values))
    return float(steps.min()) if len(steps) else 0.0
