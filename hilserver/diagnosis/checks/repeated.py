"""Dropouts: samples that are missing in the log, or stand there again and again for a while."""

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.checks.support import (
    SPAN_S,
    along,
    alternates,
    data_fault,
    listed,
    measured_channels,
    runs_of,
    subset,
)
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    FEWEST_EVENTS,
    IRREGULAR,
    MISSING_IN_BURSTS,
    MISSING_SLOWEST_S,
    SHORTEST_BURST,
)
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters


def find(log: MeasuredLog, _robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find repeated and missing samples; repetitions are left out."""
    kept: dict[str, Channel] = {}
    repeated: dict[str, float] = {}
    missing: dict[str, float] = {}
    for name in measured_channels(log.channels):
        channel = log[name]
        again = None if name.endswith("duty_pct") else _repetitions(channel)
        if again is not None:
            repeated[name] = float(again.mean())
            kept[name] = subset(channel, ~again)
        elif log.has_stamps and (share := _missing(channel, SHORTEST_BURST)) > MISSING_IN_BURSTS:
            missing[name] = share
    if log.has_stamps and not missing and (share := _missing(_rows(log), 1)) > IRREGULAR:
        missing = dict.fromkeys(measured_channels(log.channels), share)
    findings = []
    if repeated:
        findings.append(_finding(repeated, "stand there again instead of new ones"))
    if missing:
        findings.append(_finding(missing, "are missing"))
    return log.with_channels(kept), findings


def _rows(log: MeasuredLog) -> Channel:
    """Return the rows of the table: the stamps of all channels."""
    stamps = np.unique(np.concatenate([along(channel) for channel in log.channels.values()]))
    span = np.floor(stamps / SPAN_S + 0.5).astype(np.int64)
    return Channel(stamps - SPAN_S * span, stamps, span)


def _finding(shares: dict[str, float], what: str) -> Finding:
    share = float(np.median(list(shares.values())))
    return data_fault(
        "dropouts",
        shares,
        share,
        (min(shares.values()) * 0.8, max(shares.values()) * 1.2),
        "1",
        f"{listed(list(shares))}: {100 * share:.2g} % of the samples {what}, in bursts: look for"
        " the recorder's or the radio's interruptions.",
    )


def _repetitions(channel: Channel) -> NDArray[np.bool_] | None:
    """Return which samples repeat the one before in bursts; None if the channel is sound.

    Judged only where equal values are no accident: in a channel with noise of its own, which a
    computed one (the duty) and a coarse one have not. Rounded noise repeats itself now and then.
    """
    if len(channel) < 200:
        return None
    runs = runs_of(channel)
    short = runs.length < SHORTEST_BURST
    if not short.any() or np.mean(runs.length[short] == 1) < 0.95:
        return None
    steps = np.diff(channel.values)
    steps = steps[steps != 0]
    if not alternates(steps):
        return None
    least = 0.05 * float(np.median(np.abs(steps)))
    size = np.abs(channel.values)
    burst = ~short & (channel.values[runs.first] != 0)
    burst &= size[runs.first] < size.max()  # a limited sensor stands there, too
    sudden = burst & (runs.before > least) & (runs.after > least)
    samples = int(runs.length[burst].sum())
    by_chance = len(runs.length) * float(np.mean(runs.length > 1)) ** (SHORTEST_BURST - 1)
    fewest = max(FEWEST_EVENTS * (1.0 + by_chance), 0.7 * burst.sum())
    if sudden.sum() < fewest or samples > 0.5 * len(channel):
        return None
    again = np.repeat(burst, runs.length)
    again[runs.first] = False
    return again


def _missing(channel: Channel, fewest: int) -> float:
    """Return the share of samples missing in gaps of at least `fewest`; 0 without a steady rate."""
    steps = np.diff(channel.t_s)[np.diff(channel.span) == 0]
    if len(steps) < 200:
        return 0.0
    means = np.convolve(steps, np.ones(20) / 20, mode="valid")
    period_s = float(np.quantile(means, 0.3))
    if not 0 < period_s < MISSING_SLOWEST_S or np.mean(np.abs(steps / period_s - 1.0) < 0.5) < 0.7:
        return 0.0
    lost = np.maximum(np.rint(steps / period_s) - 1, 0)
    lost[lost < fewest] = 0
    if (lost > 0).sum() < FEWEST_EVENTS:
        return 0.0
    expected = float(steps.sum()) / period_s
    return min(float(lost.sum()) / expected, max(1.0 - len(steps) / expected, 0.0))
