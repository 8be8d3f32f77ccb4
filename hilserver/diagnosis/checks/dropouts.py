"""Dropouts: samples that are missing from the log, or are repeated for a while."""

import numpy as np

from hilserver.diagnosis.checks.repetitions import repeated
from hilserver.diagnosis.checks.runs import Faults, RunFault, classified, corrected
from hilserver.diagnosis.checks.support import (
    SPAN_S,
    along,
    data_fault,
    listed,
    measured_channels,
    standing,
)
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    FEWEST_EVENTS,
    IRREGULAR,
    MISSING_IN_BURSTS,
    MISSING_SLOWEST_S,
    NEARLY_ALL,
    SHORTEST_BURST,
)
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters


def find_missing(
    log: MeasuredLog, _: RobotParameters
) -> tuple[MeasuredLog, list[Finding]]:
    """Find samples that are missing from the log."""
    names = measured_channels(log.channels)
    if not log.has_stamps:
        return log, []
    shares = {n: missing(log[n], SHORTEST_BURST) for n in names}
    gone = {n: RunFault(log[n], s) for n, s in shares.items() if s > MISSING_IN_BURSTS}
    if not gone and (share := missing(_rows(log), 1)) > IRREGULAR:
        gone = {n: RunFault(log[n], share) for n in names}
    return log, [_finding(gone, "are missing")] if gone else []


def find_repeated(
    log: MeasuredLog, _: RobotParameters
) -> tuple[MeasuredLog, list[Finding]]:
    """Find single channels that repeat samples; the repetitions are left out."""
    names = (n for n in measured_channels(log.channels) if not n.endswith("duty_pct"))
    again = classified(
        names, lambda name: repeated(log[name], standing(log, log[name]))
    )
    findings = [_finding(again, "repeat the previous sample")] if again else []
    return corrected(log, again), findings


def _rows(log: MeasuredLog) -> Channel:
    """Return the rows of the table: the stamps of all channels."""
    stamps = np.unique(
        np.concatenate([along(channel) for channel in log.channels.values()])
    )
    span = np.floor(stamps / SPAN_S + 0.5).astype(np.int64)
    return Channel(stamps - SPAN_S * span, stamps, span)


def _finding(faults: Faults, what: str) -> Finding:
    shares = [fault.figure for fault in faults.values()]
    share, interval = float(np.median(shares)), (min(shares) * 0.8, max(shares) * 1.2)
    text = (
        f"{listed(list(faults))}: {100 * share:.2g} % of the samples {what}: look for"
        " interruptions of the recorder or the radio link."
    )
    return data_fault("dropouts", faults, share, interval, "1", text)


def missing(channel: Channel, fewest: int) -> float:
    """Return the share of samples missing in gaps of at least `fewest`; 0 without a steady rate."""
    steps = np.diff(channel.t_s)[np.diff(channel.span) == 0]
    if len(steps) < 200:
        return 0.0
    means = np.convolve(steps, np.ones(20) / 20, mode="valid")
    period_s = float(np.quantile(means, 0.3))
    if (
        not 0 < period_s < MISSING_SLOWEST_S
        or np.mean(np.abs(steps / period_s - 1.0) < 0.5) < 0.7
    ):
        return 0.0

    # Among many gaps few means of steps have none, so this period is too long. Most steps still
    # round to the number of periods that they last, and with a better period the others do, too.
    exact_s = period_s
    for _ in range(2):
        exact_s = float(steps.sum() / np.rint(steps / exact_s).sum())

    # A source without a clock has steps of any length, and its long ones are no gaps.
    periods = steps / exact_s
    if np.mean(np.abs(periods - np.rint(periods)) < 0.25) > NEARLY_ALL:
        period_s = exact_s

    lost = np.maximum(np.rint(steps / period_s) - 1, 0)
    lost[lost < fewest] = 0
    if (lost > 0).sum() < FEWEST_EVENTS:
        return 0.0
    expected = float(steps.sum()) / period_s
    return min(float(lost.sum()) / expected, max(1.0 - len(steps) / expected, 0.0))
