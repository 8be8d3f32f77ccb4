"""Set-points recorded as measurement: the speed column is the set-point column, or a late copy."""

import numpy as np

from hilserver.diagnosis.checks.support import along, data_fault, listed, row_period_s
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    COMMAND_SLOWEST_S,
    COPIED_LEAST_CHANGE_RPM,
    FEWEST_CHANGES,
    NEARLY_ALL,
    NEGLIGIBLE,
)
from hilserver.measured.arrays import Array
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters

CAUSE = "setpoint_as_measurement"


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find wheel speeds that are copies of set-points; they are left out of the log."""
    copies: dict[str, float] = {}
    for wheel in WHEELS:
        name = f"wheel.{wheel}.speed_rpm"
        sent = f"wheel.{wheel}.setpoint_rpm"
        if log.has(name, sent):
            lag_s = _lag_of_copy(log[sent], log[name], _rpm_per_s(robot))
            if lag_s is not None:
                copies[name] = lag_s
    if not copies:
        return log, []
    lag_s = float(np.median(list(copies.values())))
    how = "the set-point itself" if lag_s == 0 else f"the set-point of {lag_s * 1e3:.0f} ms before"
    finding = data_fault(
        CAUSE,
        copies,
        lag_s,
        None,
        "s",
        f"The wheel speed in {listed(list(copies))} is no measurement but {how}: record the"
        " measured speeds; these columns were dropped.",
    )
    return log.without(copies), [finding]


def _rpm_per_s(robot: RobotParameters) -> float:
    """Return the acceleration at full duty from rest, beyond which no drive goes."""
    return robot.process.gain * robot.controller.limit_pct / robot.process.t1_s


def _lag_of_copy(sent: Channel, speed: Channel, rpm_per_s: float) -> float | None:
    """Return by how much `speed` is a late copy of `sent`, None if it is none."""
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
        wide_rpm = 1.5 * rpm_per_s * period_s
        if _is_copy(
            speed.values[at + rows], held[at], speed.values[at + rows - 1], held[at - 1], wide_rpm
        ):
            return rows * period_s
    return None


def _is_copy(now: Array, sent: Array, last: Array, sent_last: Array, wide_rpm: float) -> bool:
    """Return whether the speed jumps with the set-point, from its old value to its new one.

    An exact copy agrees to the last digits; a noisy one follows at once where no drive could.
    """
    step = np.abs(sent - sent_last)
    error = np.maximum(np.abs(now - sent), np.abs(last - sent_last))
    wide = step > wide_rpm
    exact = error <= NEGLIGIBLE * np.minimum(step, 1.0)
    return bool(
        (len(step) >= FEWEST_CHANGES and exact.mean() >= NEARLY_ALL)
        or (
            wide.sum() >= FEWEST_CHANGES and np.mean(error[wide] <= 0.05 * step[wide]) >= NEARLY_ALL
        )
    )


def _held_at(sent: Channel, speed: Channel) -> Array:
    """Return the set-point that holds at each sample of `speed`, NaN before the first."""
    index = np.searchsorted(along(sent), along(speed) + 1e-6, side="right") - 1
    there = (index >= 0) & (sent.span[np.maximum(index, 0)] == speed.span)
    return np.where(there, sent.values[np.maximum(index, 0)], np.nan)
