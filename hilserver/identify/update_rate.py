"""How often a controller acts, read from its command during the rise after a step.

A controller with a period writes a new command once per period while the error is large. The
distances between changes of the command are therefore the period, or the distance of the rows if
that is longer. A slow update rate looks like a delay in the speed, but is not one.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Final

import numpy as np
from scipy import stats

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.identify.estimates import Estimate
from hilserver.identify.wheels import files, present
from hilserver.measured.data import MeasuredLog

RISE: Final = 0.632
FEWEST_FOR_A_RATE: Final = 10
_CHANGES_MIN = 5


@dataclass(frozen=True)
class WheelRise:
    """The rise of one wheel after the first step of its set-point."""

    wheel: str
    # from the step to 63.2 % of the final speed; the interval comes from the distance of the rows
    # and the scatter of the final speed
    rise_s: Estimate


@dataclass(frozen=True)
class UpdateRate:
    """Update period and rise of one log."""

    file: str
    period_s: Estimate
    row_s: float
    changes: int
    rises: tuple[WheelRise, ...]
    standard_error_s: float


@dataclass(frozen=True)
class RateComparison:
    """Two logs, the faster controller first."""

    faster: str
    slower: str
    p_value: float
    distinguishable: bool


def identify_update_rate(log: MeasuredLog) -> UpdateRate:
    """Identify the update period from the first step in a log.

    LogError without set-point, duty and speed of a wheel, or without a step.
    """
    wheels = [w for w in present(log, "duty_pct") if log.has(*_names(w))]
    if not wheels:
        raise LogError(
            f"{files(log)}: the update rate needs setpoint_rpm, duty_pct and speed_rpm of a wheel"
        )
    rises = []
    gaps = []
    rows = []
    for wheel in wheels:
        rise, changed_s, row_s = _of_wheel(log, wheel)
        rises.append(rise)
        gaps.append(np.diff(changed_s))
        rows.append(row_s)
    row_s = float(np.median(rows))
    apart = max(gaps, key=len)
    if len(apart) < _CHANGES_MIN:
        raise LogError(
            f"{files(log)}: the command changes less than {_CHANGES_MIN + 1} times during the "
            "rise; the controller is faster than the row rate, or there is no step"
        )
    # From the scatter of the distances or, if larger, the rounding of the stamps.
    count = len(apart)
    steps = np.abs(np.diff(np.unique(np.round(apart, 9))))
    resolution = float(steps.min()) if len(steps) else float(apart.min()) * 0.1
    rounded = resolution / math.sqrt(6.0) / math.sqrt(count)
    error = max(float(apart.std(ddof=1)) / math.sqrt(count), rounded)
    half = float(stats.t.ppf(0.975, len(apart) - 1)) * error
    period = float(apart.mean())
    estimate = Estimate(period, (max(period - half, 0.0), period + half), "s")
    return UpdateRate(
        files(log),
        estimate,
        row_s,
        len(apart) + 1,
        tuple(rises),
        error,
    )


def compare(rates: Sequence[UpdateRate], level: float = 0.05) -> list[RateComparison]:
    """Compare logs with neighbouring periods by Welch's test.

    `level` is shared among all comparisons (Bonferroni).
    """
    ordered = sorted(rates, key=lambda rate: rate.period_s.value)
    found = []
    for fast, slow in pairwise(ordered):
        variances = (fast.standard_error_s**2, slow.standard_error_s**2)
        of_fast = variances[0] ** 2 / (fast.changes - 2)
        of_slow = variances[1] ** 2 / (slow.changes - 2)
        freedom = sum(variances) ** 2 / (of_fast + of_slow)
        apart_s = slow.period_s.value - fast.period_s.value
        score = apart_s / math.sqrt(sum(variances))
        p_value = 2.0 * float(stats.t.sf(score, freedom))
        clear = p_value * (len(ordered) - 1) < level
        found.append(RateComparison(fast.file, slow.file, p_value, clear))
    return found


def _names(wheel: str) -> tuple[str, ...]:
    return tuple(
        f"wheel.{wheel}.{q}" for q in ("setpoint_rpm", "duty_pct", "speed_rpm")
    )


def _of_wheel(log: MeasuredLog, wheel: str) -> tuple[WheelRise, Array, float]:
    """Return the rise, the stamps of command changes during it, and the distance of the rows."""
    setpoint, duty, speed = (log[name] for name in _names(wheel))
    aims = np.flatnonzero(setpoint.values != 0.0)
    if not len(aims):
        raise LogError(
            f"{files(log)}: the set-point of {wheel} is always 0; there is no step"
        )
    span = int(setpoint.span[aims[0]])
    start_s = float(setpoint.t_s[aims[0]])
    t_s, values = speed.of(span)
    is_other_value = setpoint.values != setpoint.values[aims[0]]
    others = (setpoint.span == span) & is_other_value
    later = others & (setpoint.t_s > start_s)
    end_s = float(setpoint.t_s[later].min(initial=np.inf))
    step = (t_s >= start_s) & (t_s < end_s)
    t_s = t_s[step]
    values = values[step]
    if len(values) < FEWEST_FOR_A_RATE:
        raise LogError(
            f"{files(log)}: {len(values)} samples of {wheel} before its set-point changes again;"
            f" an update rate needs {FEWEST_FOR_A_RATE}: hold the set-point longer"
        )
    settled = values[len(values) // 2 :]
    final = float(np.median(settled))
    spread_of_all = 1.96 * float(np.std(settled))
    independent = max(len(settled) / 10.0, 1.0)
    spread = spread_of_all / math.sqrt(independent)
    way = math.copysign(1.0, final)
    moments = [
        _first(t_s, way * values, RISE * abs(final) + extra)
        for extra in (0.0, -spread, spread)
    ]
    row_s = float(np.median(np.diff(t_s)))
    interval = (moments[1] - row_s - start_s, moments[2] - start_s)
    rise = Estimate(moments[0] - start_s, interval, "s")
    at_s, command = duty.of(span)
    changed = np.flatnonzero(np.diff(command) != 0.0) + 1
    changed_s = at_s[changed]
    while_rising = changed_s[(changed_s >= start_s) & (changed_s <= moments[0])]
    return (
        WheelRise(wheel, rise),
        while_rising,
        row_s,
    )


def _first(t_s: Array, values: Array, level: float) -> float:
    above = np.flatnonzero(values >= level)
    if len(above):
        return float(t_s[above[0]])
    return float(t_s[-1])
