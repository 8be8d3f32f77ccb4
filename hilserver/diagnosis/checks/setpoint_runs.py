"""Set-points that the recorder derived from others: interpolated ones, and held ones.

Interpolated: the robot received stairs, the log shows ramps. Their corners lie on the slower clock:
pieces of constant slope last one of its periods, or a whole number of them.

Held: a machine that really receives set-points only now and then follows them afterwards, on
average half a period behind the straight lines between them. One that is closer to these lines
received more set-points than the log holds.
"""

import numpy as np

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.checks.runs import (
    RunFault,
    classified,
    corrected,
    rate_fault,
    runs_of,
)
from hilserver.diagnosis.checks.support import along, row_period_s, subset
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    COMMAND_SLOWEST_S,
    FEWEST_CHANGES,
    FEWEST_EVENTS,
    FEWEST_PIECES,
    IRREGULAR,
    NEARLY_ALL,
    NEGLIGIBLE,
    SAME,
    SPARSE_BETTER,
    SPARSE_MOST_PERIODS,
    SPARSE_USUAL_SHARE,
)
from hilserver.measured.channels import SETPOINTS, SPEEDS, TWIST
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters


def find_interpolated(
    log: MeasuredLog, _: RobotParameters
) -> tuple[MeasuredLog, list[Finding]]:
    """Find interpolated set-points; only the samples at their corners are kept, as held values."""
    names = (name for name in (*SETPOINTS, *TWIST) if name in log)
    faults = classified(names, lambda name: interpolated(log[name]))
    text = (
        "The set-points were sent at {rate_hz} Hz but interpolated linearly in the log, which"
        " the robot never saw: record them as they were sent; they were treated as steps."
    )
    findings = [rate_fault("interpolated_setpoint", faults, text)] if faults else []
    return corrected(log, faults), findings


def interpolated(channel: Channel) -> RunFault | None:
    """Return the samples that the slower clock sent, and its rate; None if there is none."""
    found = period_rows(channel)
    if found is None:
        return None
    rows, corners = found
    rate_hz = 1.0 / (rows * row_period_s(channel))
    return RunFault(
        subset(channel, _on_clock(channel, rows, corners)),
        rate_hz,
        NEGLIGIBLE * rate_hz,
    )


def pieces(channel: Channel) -> tuple[Indices, Array]:
    """Return first sample and slope of every piece of constant slope."""
    dt = np.diff(channel.t_s)
    inside = (np.diff(channel.span) == 0) & (dt > 0)
    slope = np.where(
        inside, np.diff(channel.values) / np.where(inside, dt, 1.0), np.nan
    )
    size = np.maximum(np.abs(slope[1:]), np.abs(slope[:-1]))
    moving = np.abs(slope[np.nan_to_num(slope) != 0])
    least = SAME * float(np.median(moving)) if len(moving) else 0.0
    bends = ~(np.abs(np.diff(slope)) <= SAME * size + 0.1 * least)
    first = np.concatenate(([0], np.flatnonzero(bends) + 1))
    return first, slope[first]


def period_rows(channel: Channel) -> tuple[int, Indices] | None:
    """Return the slower clock's period in samples and the corners; None if there is none."""
    row_s = row_period_s(channel)
    if len(channel) < 100 or row_s <= 0:
        return None
    first, slope = pieces(channel)
    length = np.diff(first, append=len(channel) - 1)
    whole = np.isfinite(slope)
    whole[1:] &= whole[:-1]  # the first piece of a span may begin anywhere
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


def _on_clock(channel: Channel, rows: int, corners: Indices) -> Mask:
    """Return which samples the slower clock sent: those a whole number of periods from a corner."""
    index = np.arange(len(channel))
    before = np.clip(np.searchsorted(corners, index, side="right") - 1, 0, None)
    keep: Mask = (index - corners[before]) % rows == 0
    begins = np.diff(channel.span, prepend=-1) != 0
    return np.asarray(keep | begins)


def find_sparse(
    log: MeasuredLog, _: RobotParameters
) -> tuple[MeasuredLog, list[Finding]]:
    """Find set-points that are held only in the log; straight lines replace those between."""
    speed_of = {a: b for a, b in zip(SETPOINTS, SPEEDS, strict=True) if log.has(a, b)}
    faults = classified(speed_of, lambda name: sparse(log[name], log[speed_of[name]]))
    text = (
        "{names}: the log contains only {rate_hz} set-points a second and repeats each, but the"
        " wheels followed others sent in between: record every set-point; linear interpolation"
        " was used instead."
    )
    findings = [rate_fault("held_samples", faults, text)] if faults else []
    return corrected(log, faults), findings


def sparse(channel: Channel, speed: Channel) -> RunFault | None:
    """Return straight lines between set-points if a speed followed sooner than they came."""
    known = sent_rate(channel)
    if known is None:
        return None
    lines = _lines(channel, 1.0 / known[0])
    return (
        RunFault(lines, *known)
        if _followed(channel, lines, speed, 1.0 / known[0])
        else None
    )


def sent_rate(channel: Channel) -> tuple[float, float] | None:
    """Return the rate of the slower clock and its standard error; None if there is none."""
    lasted = runs_of(channel).duration_s
    lasted = lasted[np.isfinite(lasted)]
    if len(lasted) < FEWEST_CHANGES:
        return None
    period_s = float(np.quantile(lasted, 0.5 * SPARSE_USUAL_SHARE))
    usual = lasted[np.abs(lasted - period_s) < 0.3 * period_s]
    if len(usual) < max(FEWEST_CHANGES, SPARSE_USUAL_SHARE * len(lasted)):
        return None
    if np.mean(lasted < 0.7 * period_s) > IRREGULAR:
        return None
    some = lasted[lasted < SPARSE_MOST_PERIODS * period_s]
    periods = np.rint(some / float(np.median(usual)))
    period_s = float(some.sum() / periods.sum())
    sd = (
        float((some - periods * period_s).std())
        * np.sqrt(len(some))
        / float(periods.sum())
    )
    return 1.0 / period_s, sd / period_s**2


def _lines(channel: Channel, period_s: float) -> Channel:
    """Return straight lines between the set-points; those that lasted longer are first held."""
    first = runs_of(channel).first
    stamps = along(channel)
    at, values = stamps[first], channel.values[first]
    lasts = np.diff(at) > 1.5 * period_s
    knee = at[1:][lasts] - period_s
    at = np.concatenate([at, knee])
    values = np.concatenate([values, values[:-1][lasts]])
    order = np.argsort(at, kind="stable")
    return channel.with_values(np.interp(stamps, at[order], values[order]))


def _followed(
    channel: Channel, lines: Channel, speed: Channel, period_s: float
) -> bool:
    """Return whether a speed follows the lines, and sooner than held set-points allow."""
    row_s = row_period_s(channel)
    if period_s < (FEWEST_EVENTS - 0.5) * row_s:
        return False
    lags = np.arange(-1.0, 1.51, 0.05) * period_s
    by_lines = _misfit(lines, speed, lags)
    by_stairs = _misfit(channel, speed, lags, held=True)
    best = int(np.argmin(by_lines))
    soon = lags[best] + 0.75 * row_s < 0.5 * period_s
    return bool(
        soon
        and lags[best] > -0.5 * period_s
        and by_lines[best] < SPARSE_BETTER * by_stairs.min()
    )


def _misfit(
    inputs: Channel, speed: Channel, lags: Array, *, held: bool = False
) -> Array:
    """Return the mean square of the speed minus the input, for each lag [s] of the input."""
    at, stamps = along(speed), along(inputs)
    out = np.empty(len(lags))
    for i, lag in enumerate(lags):
        if held:
            index = np.searchsorted(stamps, at - lag + 1e-6, side="right") - 1
            expected = inputs.values[np.clip(index, 0, None)]
        else:
            expected = np.interp(at - lag, stamps, inputs.values)
        out[i] = float(np.mean((speed.values - expected) ** 2))
    return out
