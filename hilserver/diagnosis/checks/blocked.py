"""A robot that stood still although its wheels drove it: blocked by something, or lifted."""

from dataclasses import replace
from typing import Final, NamedTuple

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.checks.motion import (
    MotionWindows,
    ends_in,
    mean_in,
    rolled,
    windows_of,
)
from hilserver.diagnosis.checks.support import SPAN_S
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    BLOCKED_FEWEST,
    BLOCKED_LEAST_WAY_M,
    HALF,
    STANDS,
    TURNS_RAD_S,
)
from hilserver.measured.channels import GYRO, POSITION
from hilserver.measured.data import MeasuredLog
from hilserver.measured.pauses import Pieces, cut
from hilserver.plant.parameters import RobotParameters

WAY_S: Final = 2.0  # distance and position are compared over this time


class Spell(NamedTuple):
    """Stretch of a span in which the robot was blocked [s]."""

    span: int
    begin_s: float
    end_s: float


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Report when the robot was blocked and leave it out: nothing here models what held it."""
    if not log.has(*POSITION, GYRO):
        return log, []
    windows = windows_of(log, WAY_S)
    way_m = _asked_m(log, robot, windows)
    is_driven = way_m > BLOCKED_LEAST_WAY_M
    is_blocked = is_driven & _stands(log, windows, way_m)
    spells = _spells(is_blocked, windows)
    if not spells or is_blocked.sum() > HALF * is_driven.sum():
        return log, []
    times = "once" if len(spells) == 1 else f"{len(spells)} times"
    longest = max(spells, key=lambda spell: spell.end_s - spell.begin_s)
    note = (
        f"the robot stood still {times} although its wheels were turning or commanded, the"
        " longest from t_s ="
        f" {longest.begin_s:.4g} to {longest.end_s:.4g}: it was blocked or lifted; these"
        " measurements were left out"
    )
    left = cut(
        log, [_left(i, s.start_s, s.end_s, spells) for i, s in enumerate(log.spans)]
    )
    return replace(left, notices=(*log.notices, note)), []


def _asked_m(log: MeasuredLog, robot: RobotParameters, windows: MotionWindows) -> Array:
    """Return the distance that the wheels make, or are asked to make, in each window."""
    asked = np.zeros(len(windows))
    for what in ("speed_rpm", "setpoint_rpm"):
        speed = rolled(log, what, windows, robot)
        if speed is not None:
            asked = np.fmax(asked, speed)
    return asked * (windows.end - windows.begin)


def _stands(log: MeasuredLog, windows: MotionWindows, way_m: Array) -> Mask:
    """Return in which windows position and heading stay the same; False where unknown."""
    (x0, x1, _), (y0, y1, _) = (ends_in(log[name], windows) for name in POSITION)
    is_there = np.hypot(x1 - x0, y1 - y0) < STANDS * way_m
    return np.asarray(is_there & (np.abs(mean_in(log[GYRO], windows)) < TURNS_RAD_S))


def _spells(is_blocked: Mask, windows: MotionWindows) -> list[Spell]:
    """Return every spell of some length, with the windows around it: it began and ended in them."""
    spans, found = np.rint(windows.begin / SPAN_S).astype(np.int64), []
    for span in np.unique(spans).tolist():
        mine = spans == span
        begin_s, end_s = (
            windows.begin[mine] - SPAN_S * span,
            windows.end[mine] - SPAN_S * span,
        )
        borders = np.flatnonzero(np.diff(is_blocked[mine], prepend=False, append=False))
        for first, after in borders.reshape(-1, 2).tolist():
            if after - first >= BLOCKED_FEWEST:
                last = min(after, len(end_s) - 1)
                found.append(
                    Spell(span, float(begin_s[max(first - 1, 0)]), float(end_s[last]))
                )
    return found


def _left(span: int, start_s: float, end_s: float, spells: list[Spell]) -> Pieces:
    """Return what is left of a span."""
    mine = [spell for spell in spells if spell.span == span]
    begins, ends = (
        [start_s, *(s.end_s for s in mine)],
        [*(s.begin_s for s in mine), end_s],
    )
    pieces = zip(begins, ends, strict=True)
    return [(begin, end) for begin, end in pieces if end - begin > WAY_S]
