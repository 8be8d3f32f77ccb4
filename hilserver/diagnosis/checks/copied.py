"""Set-points recorded as measurement: speeds that are the set-points, or a late copy of them."""

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.runs import RunFault, classified, corrected
from hilserver.diagnosis.checks.support import along, data_fault, listed, row_period_s
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    COMMAND_SLOWEST_S,
    COPIED_LEAST_CHANGE_RPM,
    FEWEST_CHANGES,
    NEARLY_ALL,
    NEGLIGIBLE,
)
from hilserver.measured.channels import SETPOINTS, SPEEDS
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find wheel speeds that are copies of set-points; they are left out of the log."""
    sent = {b: a for a, b in zip(SETPOINTS, SPEEDS, strict=True) if log.has(a, b)}
    # no drive accelerates faster than at full duty from rest
    fastest_rpm_s = robot.process.gain * robot.controller.limit_pct / robot.process.t1_s
    copies = classified(
        sent, lambda name: copy_of(log[sent[name]], log[name], fastest_rpm_s)
    )
    if not copies:
        return log, []
    lag_s = float(np.median([copy.figure for copy in copies.values()]))
    how = (
        "the set-point itself"
        if lag_s == 0
        else f"the set-point {lag_s * 1e3:.0f} ms earlier"
    )
    text = (
        f"The wheel speed in {listed(list(copies))} is not a measurement but {how}: record the"
        " measured speeds; these columns were dropped."
    )
    finding = data_fault("setpoint_as_measurement", copies, lag_s, None, "s", text)
    return corrected(log, copies), [finding]


def copy_of(sent: Channel, speed: Channel, fastest_rpm_s: float) -> RunFault | None:
    """Return by how much `speed` is a late copy of `sent`, None if it is not a copy."""
    period_s = row_period_s(speed)
    if period_s <= 0 or len(sent) < FEWEST_CHANGES:
        return None
    held = _held_at(sent, speed)
    step = np.abs(np.diff(held, prepend=held[:1]))
    step[np.diff(speed.span, prepend=-1) != 0] = 0.0
    changed = np.flatnonzero(np.nan_to_num(step) > COPIED_LEAST_CHANGE_RPM)
    for rows in range(int(COMMAND_SLOWEST_S / period_s) + 1):
        at = changed[changed + rows < len(speed)]
        at = at[speed.span[at] == speed.span[at + rows]]
        now, before = speed.values[at + rows], speed.values[at + rows - 1]
        if is_copy(now, held[at], before, held[at - 1], 1.5 * fastest_rpm_s * period_s):
            return RunFault(None, rows * period_s)
    return None


def is_copy(
    now: Array, sent: Array, last: Array, sent_last: Array, wide_rpm: float
) -> bool:
    """Return whether the speed jumps with the set-point, from its old value to the new one.

    An exact copy agrees to the last digits; a noisy one follows at once where no drive could.
    """
    step = np.abs(sent - sent_last)
    error = np.maximum(np.abs(now - sent), np.abs(last - sent_last))
    wide = step > wide_rpm
    exact = error <= NEGLIGIBLE * np.minimum(step, 1.0)
    return bool(
        (len(step) >= FEWEST_CHANGES and exact.mean() >= NEARLY_ALL)
        or (
            wide.sum() >= FEWEST_CHANGES
            and np.mean(error[wide] <= 0.05 * step[wide]) >= NEARLY_ALL
        )
    )


def _held_at(sent: Channel, speed: Channel) -> Array:
    """Return the set-point that holds at each sample of `speed`, NaN before the first."""
    index = np.searchsorted(along(sent), along(speed) + 1e-6, side="right") - 1
    there = (index >= 0) & (sent.span[np.maximum(index, 0)] == speed.span)
    return np.where(there, sent.values[np.maximum(index, 0)], np.nan)
