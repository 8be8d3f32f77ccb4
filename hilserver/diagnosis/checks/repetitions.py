"""Repeated values in measured channels: stuck, held at a slower clock, repeated in bursts.

Stairs of a coarse or slow encoder are not held samples: they rise by one or two quanta, and while
the wheel accelerates they change in every row.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.checks.runs import (
    Faults,
    RunFault,
    Runs,
    alternates,
    classified,
    corrected,
    rate_fault,
    resolution,
    runs_of,
)
from hilserver.diagnosis.checks.support import (
    along,
    data_fault,
    listed,
    measured_channels,
    row_period_s,
    subset,
)
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    FEWEST_CHANGES,
    FEWEST_EVENTS,
    FEWEST_SAMPLES,
    HALF,
    HELD_LONGEST_ROW,
    HELD_MOST_PERIODS,
    HELD_OFF_CLOCK,
    HELD_QUANTA,
    HELD_SHARE,
    HELD_SLOWEST_HZ,
    HELD_SPREAD,
    IRREGULAR,
    LARGE_STEP_RPM,
    NEGLIGIBLE,
    SHORTEST_BURST,
)
from hilserver.measured.channels import GYRO, NAV_X, NAV_Y, SETPOINTS, YAW
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters

AXES: Final = {NAV_X: NAV_Y, NAV_Y: NAV_X}
TURNS: Final = (YAW, GYRO)


def find_stuck(
    log: MeasuredLog, _: RobotParameters
) -> tuple[MeasuredLog, list[Finding]]:
    """Find channels that never change although they should, and leave them out.

    In a simulated log without any noise that proves nothing: there a robot that drives along an
    axis keeps its other coordinate to the bit.
    """
    names = measured_channels(log.channels)
    if not any(_is_noisy(log[name]) for name in names):
        return log, []
    stuck = [
        name for name in names if is_constant(log[name]) and should_change(log, name)
    ]
    if not stuck:
        return log, []
    text = (
        f"{listed(stuck)}: the same value in every row although the robot moved, as if the"
        " sensor were stuck or not connected; the column was left out."
    )
    return log.without(stuck), [
        data_fault("held_samples", stuck, 0.0, None, "Hz", text)
    ]


def is_constant(channel: Channel) -> bool:
    """Return whether a channel has one value."""
    return len(channel) >= FEWEST_SAMPLES and float(np.ptp(channel.values)) == 0.0


def _is_noisy(channel: Channel) -> bool:
    """Return whether a channel goes up and down from row to row."""
    steps = np.diff(channel.values)
    return len(steps) >= FEWEST_SAMPLES and alternates(steps)


def should_change(log: MeasuredLog, name: str) -> bool:
    """Return whether the machine moved in a way that a channel would show."""
    if name in AXES:
        other = log.channels.get(AXES[name])
        known = other is not None and (_is_noisy(other) or is_constant(other))
        return known and any(_range(log, wheel) > LARGE_STEP_RPM for wheel in WHEELS)
    if name in TURNS:
        return max(_range(log, "fl", "fr"), _range(log, "rl", "rr")) > LARGE_STEP_RPM
    _, _, wheel_part = name.partition("wheel.")
    wheel, _, quantity = wheel_part.partition(".")
    return quantity in ("speed_rpm", "duty_pct") and _range(log, wheel) > LARGE_STEP_RPM


def _range(log: MeasuredLog, *wheels: str) -> float:
    """Return by how much a wheel's speed varies, or the turn that two wheels make [rpm].

    Set-points count, or measured speeds if none is known. Right wheels are mirrored.
    """
    values = []
    for wheel in wheels:
        wanted = (f"wheel.{wheel}.setpoint_rpm", f"wheel.{wheel}.speed_rpm")
        channel = next(
            (log[name] for name in wanted if name in log and len(log[name])), None
        )
        if channel is None:
            return 0.0
        values.append(channel.values)
    if len({len(v) for v in values}) > 1:
        return 0.0
    return float(np.ptp(np.sum(values, axis=0)))


def find_held(
    log: MeasuredLog, _: RobotParameters
) -> tuple[MeasuredLog, list[Finding]]:
    """Find channels on a slower clock; of each run only the first, real sample is kept."""
    changes = changes_s(log)
    runs = {name: runs_of(log[name]) for name in measured_channels(log.channels)}
    slow = classified(runs, lambda name: held(log[name], runs[name], changes))
    groups, findings = _alike(slow), []
    for group in groups:
        for name in group:
            begins = begins_of(
                log, name, list(group), {n: runs[n].first for n in group}
            )
            fresh = _fresh(log[name], begins, 1.0 / slow[name].figure)
            group[name] = slow[name]._replace(left=subset(log[name], fresh))
        text = (
            "{names}: a new value arrives only {rate_hz} times a second and is repeated in the"
            " rows in between: leave these empty; the repetitions were dropped."
        )
        findings.append(rate_fault("held_samples", group, text))
    return corrected(
        log, {n: f for group in groups for n, f in group.items()}
    ), findings


def begins_of(
    log: MeasuredLog, name: str, group: Sequence[str], first: dict[str, Indices]
) -> Mask:
    """Return which samples are known to be new: those at which this or another channel changed.

    A source usually sends its channels together, and one of them may stay the same by chance.
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


def changes_s(log: MeasuredLog) -> Array:
    """Return stamps at which set-points change, see `along`."""
    found = [np.empty(0)]
    for channel in (log[name] for name in SETPOINTS if name in log):
        runs = runs_of(channel)
        found.append(along(channel)[runs.first[runs.before > 0]])
    return np.unique(np.concatenate(found))


def held(channel: Channel, runs: Runs, changes: Array) -> RunFault | None:
    """Return the rate of a slower clock and its standard error; None if nothing is held."""
    steps = np.abs(np.diff(channel.values))[np.diff(channel.span) == 0]
    moving = steps[steps > 0]
    if len(moving) < FEWEST_CHANGES:
        return None
    real = max(HELD_QUANTA * resolution(channel.values), 0.2 * float(np.median(moving)))
    full = (runs.before >= real) & (runs.after >= real) & np.isfinite(runs.duration_s)
    if full.sum() < FEWEST_CHANGES:
        return None
    length, duration = runs.length[full], runs.duration_s[full]
    if np.mean(length >= 2) < HELD_SHARE or _follow(channel, runs.first, changes):
        return None
    low, middle, high = np.quantile(length, [0.1, 0.5, 0.9])
    if middle < 2:
        return None
    usual = duration[(length > 0.5 * middle) & (length < 1.6 * middle)]
    rate_hz, row_s = 1.0 / float(usual.mean()), row_period_s(channel)
    if high > HELD_SPREAD * max(low, 1.0) and not _on_a_clock(
        rate_hz * duration, rate_hz * row_s
    ):
        return None
    if rate_hz < HELD_SLOWEST_HZ or rate_hz * row_s > 0.67:
        return None
    return RunFault(
        None, rate_hz, rate_hz**2 * float(usual.std()) / np.sqrt(len(usual))
    )


def _on_a_clock(periods: Array, row: float) -> bool:
    """Return whether runs last whole periods: a rounded value may stay the same for several.

    Parameters
    ----------
    periods : ndarray
        Their durations, in periods.
    row : float
        Time between rows, in periods.
    """
    known = periods[periods < HELD_MOST_PERIODS]
    on = np.abs(known - np.rint(known)) < 0.5 * row + HELD_OFF_CLOCK
    return row < HELD_LONGEST_ROW and bool(np.mean(on) >= HELD_SHARE)


def _follow(channel: Channel, first: Indices, changes: Array) -> bool:
    """Return whether a channel changes only in response to single set-points, held long.

    Parameters
    ----------
    first : ndarray of int
        Where its runs begin, those after small steps, too: a wheel on its way makes many.
    """
    if len(changes) < 2 or len(first) > 1.5 * len(changes):
        return False
    at = along(channel)
    index = np.searchsorted(changes, at + 1e-6, side="right") - 1
    after_s = at - changes[np.clip(index, 0, None)]
    soon = (after_s >= -1e-6) & (after_s < 0.1)
    # where set-points come all the time, every sample is soon after one
    by_chance = float(soon.mean())
    return bool(soon[first].mean() > 0.5 * (1.0 + by_chance))


def _fresh(channel: Channel, begins: Mask, period_s: float) -> Mask:
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


def _alike(faults: Faults) -> list[dict[str, RunFault]]:
    """Return the channels by source: those with the same rate within 15 %."""
    groups: list[dict[str, RunFault]] = []
    for name, fault in faults.items():
        for group in groups:
            first = next(iter(group))
            same_source = name.split(".")[0] == first.split(".")[0]
            if same_source and abs(np.log(fault.figure / group[first].figure)) < 0.15:
                group[name] = fault
                break
        else:
            groups.append({name: fault})
    return groups


def repeated(channel: Channel, stands: Mask) -> RunFault | None:
    """Return a channel without the samples that repeat the previous one; None if sound.

    Judged only where equal values are no accident: in a channel with noise of its own, unlike a
    computed one (the duty) or a coarse one. Rounded noise sometimes repeats itself: then only a
    burst counts. If values never repeat otherwise, a single repetition does. While the robot
    stands (`stands`, shape (n,)) a filtered pose stays the same, too.
    """
    if len(channel) < 200:
        return None
    runs = runs_of(channel)
    once = len(np.unique(channel.values[runs.first])) > (1.0 - IRREGULAR) * len(
        runs.first
    )
    once = once and float(np.mean(runs.length > 1)) > NEGLIGIBLE
    shortest = 2 if once else SHORTEST_BURST
    short = runs.length < shortest
    if not short.any() or np.mean(runs.length[short] == 1) < 0.95:
        return None
    steps = np.diff(channel.values)
    steps = steps[steps != 0]
    if not alternates(steps):
        return None
    least = 0.05 * float(np.median(np.abs(steps)))
    size = np.abs(channel.values)
    burst = ~short & (channel.values[runs.first] != 0)
    burst &= ~np.logical_or.reduceat(stands, runs.first)
    burst &= size[runs.first] < size.max()  # a limited sensor stays there, too
    sudden = burst & (runs.before > least) & (runs.after > least)
    samples = int(runs.length[burst].sum())
    pairs = 0.0 if once else float(np.mean(runs.length > 1))
    by_chance = len(runs.length) * pairs ** (SHORTEST_BURST - 1)
    fewest = max(FEWEST_EVENTS * (1.0 + by_chance), 0.7 * burst.sum())
    if sudden.sum() < fewest or samples > 0.5 * len(channel):
        return None
    again = np.repeat(burst, runs.length)
    again[runs.first] = False
    return RunFault(subset(channel, ~again), float(again.mean()))
