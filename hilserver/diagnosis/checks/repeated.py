"""Dropouts: samples that are missing in the log, or stand there again and again for a while."""

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.checks.support import (
    data_fault,
    listed,
    measured_channels,
    runs_of,
    subset,
)
from hilserver.diagnosis.data import Channel, MeasuredLog
from hilserver.diagnosis.findings import Finding
from hilserver.plant.parameters import RobotParameters

SHORTEST_BURST = 4
FEWEST_BURSTS = 3
ALLOWED_MISSING = 0.04
"""Single rows go missing in sound logs, too."""
SLOWEST_S = 0.22
"""Slower channels keep no steady clock of which one could say that a sample is missing."""
LONG_GAP_ROWS, LONG_GAP_S = 10, 0.15


def find(log: MeasuredLog, _robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find repeated and missing samples; repetitions are left out."""
    kept: dict[str, Channel] = {}
    repeated: dict[str, float] = {}
    missing: dict[str, float] = {}
    for name in measured_channels(log.channels):
        channel = log[name]
        again = _repetitions(channel)
        if again is not None:
            repeated[name] = float(again.mean())
            kept[name] = subset(channel, ~again)
        share = _missing_share(channel) if log.has_stamps else 0.0
        if share > 0:
            missing[name] = share
    findings = []
    if repeated:
        findings.append(_finding(repeated, "stand there again instead of new ones"))
    if missing := {name: share for name, share in missing.items() if name not in repeated}:
        findings.append(_finding(missing, "are missing"))
    return log.with_channels(kept), findings


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

    Judged only where equal values are no accident: a channel that nearly always changes. Bursts
    begin behind an ordinary step, which tells them from a signal that comes to rest.
    """
    if len(channel) < 200:
        return None
    runs = runs_of(channel)
    if np.mean(runs.length[runs.length < SHORTEST_BURST] == 1) < 0.95:
        return None
    steps = np.abs(np.diff(channel.values))
    usual = float(np.median(steps[steps > 0])) if (steps > 0).any() else 0.0
    middle = np.quantile(channel.values, [0.01, 0.99])
    burst = (
        (runs.length >= SHORTEST_BURST)
        & (runs.before > 0.05 * usual)
        & (runs.after > 0.05 * usual)
        & (channel.values[runs.first] != 0)
        & (channel.values[runs.first] > middle[0] - usual)
        & (channel.values[runs.first] < middle[1] + usual)
    )
    samples = int(runs.length[burst].sum())
    if burst.sum() < FEWEST_BURSTS or samples > 0.5 * len(channel):
        return None
    again = np.repeat(burst, runs.length)
    again[runs.first] = False
    return again


def _missing_share(channel: Channel) -> float:
    """Return the share of missing samples; 0 if the channel is sound or has no steady rate."""
    steps = np.diff(channel.t_s)[np.diff(channel.span) == 0]
    if len(steps) < 200:
        return 0.0
    means = np.convolve(steps, np.ones(10) / 10, mode="valid")
    period_s = max(float(np.quantile(means, 0.3)), float(np.median(steps)))
    if not 0 < period_s < SLOWEST_S or np.mean(np.abs(steps / period_s - 1.0) < 0.5) < 0.7:
        return 0.0
    lost = np.maximum(np.floor(steps / period_s + 0.25) - 1, 0)
    share = float(lost.sum() / (lost.sum() + len(steps)))
    long = (lost >= LONG_GAP_ROWS) & (steps > LONG_GAP_S)
    return share if share > ALLOWED_MISSING or long.sum() >= FEWEST_BURSTS else 0.0
