"""Held samples: a channel that changes at a slower clock than its rows are written.

Stairs of a coarse or slow encoder are no held samples: they rise by one or two of their quanta,
and while the wheel accelerates they change in every row.
"""

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.checks.support import (
    Runs,
    along,
    data_fault,
    listed,
    measured_channels,
    resolution,
    row_period_s,
    runs_of,
    subset,
)
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    FEWEST_CHANGES,
    HALF,
    HELD_QUANTA,
    HELD_SHARE,
    HELD_SLOWEST_HZ,
    HELD_SPREAD,
)
from hilserver.measured.arrays import Array
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters

OFF_THE_CLOCK, MOST_OF_A_PERIOD = 0.05, 0.4
"""Share of a period by which runs may miss whole ones, beside half a row; longest row."""
MOST_PERIODS = 6.5
"""Of a longer run the period is not known well enough."""


def find(log: MeasuredLog, _robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find held channels; of each run only the first sample, the real one, is kept."""
    changes = _changes_s(log)
    first: dict[str, NDArray[np.int64]] = {}
    rates: dict[str, tuple[float, float]] = {}
    for name in measured_channels(log.channels):
        runs = runs_of(log[name])
        found = _rate(log[name], runs, changes)
        if found is not None:
            rates[name], first[name] = found, runs.first
    kept: dict[str, Channel] = {}
    groups = _alike(rates)
    for group in groups:
        for name in group:
            begins = _begins(log, name, group, first)
            kept[name] = subset(log[name], _fresh(log[name], begins, 1.0 / rates[name][0]))
    return log.with_channels(kept), [_finding(group, rates) for group in groups]


def _begins(
    log: MeasuredLog, name: str, group: list[str], first: dict[str, NDArray[np.int64]]
) -> NDArray[np.bool_]:
    """Return which samples are known to be new: those at which this or another channel changed.

    A source mostly sends its channels at once, and one of them may stay the same by chance.
    """
    at = along(log[name])
    begins = np.zeros(len(at), dtype=bool)
    begins[first[name]] = True
    for other in group:
        there = np.searchsorted(at, along(log[other])[first[other]])
        there = there[there < len(at)]
        if np.mean(np.isin(first[name], there)) > HALF:
            begins[there] = True
    return begins


def _changes_s(log: MeasuredLog) -> Array:
    """Return stamps at which set-points change, see `along`."""
    found = [np.empty(0)]
    for wheel in WHEELS:
        name = f"wheel.{wheel}.setpoint_rpm"
        if name in log:
            runs = runs_of(log[name])
            first = runs.first[runs.before > 0]
            found.append(along(log[name])[first])
    return np.unique(np.concatenate(found))


def _rate(channel: Channel, runs: Runs, changes: Array) -> tuple[float, float] | None:
    """Return the rate of the slower clock and its standard error; None if nothing is held."""
    steps = np.abs(np.diff(channel.values))[np.diff(channel.span) == 0]
    moving = steps[steps > 0]
    if len(moving) < FEWEST_CHANGES:
        return None
    real = max(HELD_QUANTA * resolution(channel.values), 0.2 * float(np.median(moving)))
    full = (runs.before >= real) & (runs.after >= real) & np.isfinite(runs.duration_s)
    if full.sum() < FEWEST_CHANGES:
        return None
    length, duration = runs.length[full], runs.duration_s[full]
    if np.mean(length >= 2) < HELD_SHARE or _follow(channel, runs.first[full], changes):
        return None
    low, middle, high = np.quantile(length, [0.1, 0.5, 0.9])
    if middle < 2:
        return None
    usual = duration[(length > 0.5 * middle) & (length < 1.6 * middle)]
    rate_hz, row_s = 1.0 / float(usual.mean()), row_period_s(channel)
    if high > HELD_SPREAD * max(low, 1.0) and not _on_a_clock(rate_hz * duration, rate_hz * row_s):
        return None
    if rate_hz < HELD_SLOWEST_HZ or rate_hz * row_s > 0.67:
        return None
    return rate_hz, rate_hz**2 * float(usual.std()) / np.sqrt(len(usual))


def _on_a_clock(periods: Array, row: float) -> bool:
    """Return whether runs last whole periods: a rounded value may stay the same for several.

    Parameters
    ----------
    periods : ndarray
        Their durations by the period.
    row : float
        Time between rows by the period.
    """
    known = periods[periods < MOST_PERIODS]
    on = np.abs(known - np.rint(known)) < 0.5 * row + OFF_THE_CLOCK
    return row < MOST_OF_A_PERIOD and bool(np.mean(on) >= HELD_SHARE)


def _follow(channel: Channel, first: NDArray[np.int64], changes: Array) -> bool:
    """Return whether the steps are answers to single set-points, long held themselves."""
    if len(changes) < 2 or len(changes) > 1.5 * len(first):
        return False
    at = along(channel)[first]
    index = np.clip(np.searchsorted(changes, at + 1e-6, side="right") - 1, 0, None)
    after = at - changes[index]
    return bool(np.mean((after >= -1e-6) & (after < 0.1)) > 0.5)


def _fresh(channel: Channel, begins: NDArray[np.bool_], period_s: float) -> NDArray[np.bool_]:
    """Return which samples are new: in a run of several periods one per period, evenly."""
    t, first, run = channel.t_s, np.flatnonzero(begins), np.cumsum(begins) - 1
    last = np.append(first[1:], len(t)) - 1
    length_s = np.append(t[first[1:]], t[-1]) - t[first]
    count = np.maximum(np.rint(length_s / period_s), 1.0)
    ends = np.append(channel.span[first[1:]] != channel.span[first[:-1]], True)
    count[ends] = np.maximum(np.rint((t[last] - t[first])[ends] / period_s), 1.0)
    length_s[ends] = count[ends] * period_s
    number = np.floor((t - t[first][run]) / length_s[run] * count[run] + 1e-6)
    return np.asarray(begins | (np.diff(number, prepend=0.0) > 0.0))


def _alike(rates: dict[str, tuple[float, float]]) -> list[list[str]]:
    """Return channels of one source: the same rate within 15 %."""
    groups: list[list[str]] = []
    for name, (rate_hz, _) in rates.items():
        for group in groups:
            same_source = name.split(".")[0] == group[0].split(".")[0]
            if same_source and abs(np.log(rate_hz / rates[group[0]][0])) < 0.15:
                group.append(name)
                break
        else:
            groups.append([name])
    return groups


def _finding(group: list[str], rates: dict[str, tuple[float, float]]) -> Finding:
    rate_hz = float(np.median([rates[name][0] for name in group]))
    half = 1.96 * max(float(np.median([rates[name][1] for name in group])), 0.01 * rate_hz)
    return data_fault(
        "held_samples",
        group,
        rate_hz,
        (rate_hz - half, rate_hz + half),
        "Hz",
        f"{listed(group)}: a new value comes only {rate_hz:.3g} times a second and is repeated in"
        " the rows between: leave these empty; the repetitions were dropped.",
    )
