"""Held set-points: the recording kept only some of those that the machine got.

A machine that really gets a new set-point only now and then follows it afterwards, on average half
a period behind the straight lines between them. One that is closer to these lines knew what the
log does not hold.
"""

from typing import Final

import numpy as np

from hilserver.diagnosis.checks.support import (
    along,
    data_fault,
    listed,
    row_period_s,
    runs_of,
    subset,
)
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    FEWEST_CHANGES,
    FEWEST_EVENTS,
    IRREGULAR,
    SPARSE_BETTER,
    SPARSE_USUAL_SHARE,
)
from hilserver.measured.arrays import Array
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters

LONGEST_PERIODS: Final = 12.0
"""Longer durations tell nothing of their period."""


def find(log: MeasuredLog, _robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find set-points held in the log alone; straight lines stand for what was between them."""
    kept: dict[str, Channel] = {}
    rates: list[tuple[float, float]] = []
    for wheel in WHEELS:
        name, speed = f"wheel.{wheel}.setpoint_rpm", log.channels.get(f"wheel.{wheel}.speed_rpm")
        if name not in log or speed is None:
            continue
        channel = log[name]
        rate = _rate(channel)
        if rate is None:
            continue
        lines = _lines(channel, 1.0 / rate[0])
        if _knew(channel, lines, speed, 1.0 / rate[0]):
            kept[name] = lines
            rates.append(rate)
    return log.with_channels(kept), [_finding(list(kept), rates)] if kept else []


def _rate(channel: Channel) -> tuple[float, float] | None:
    """Return the rate of the slower clock and its standard error; None where there is none."""
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
    some = lasted[lasted < LONGEST_PERIODS * period_s]
    periods = np.rint(some / float(np.median(usual)))
    period_s = float(some.sum() / periods.sum())
    sd = float((some - periods * period_s).std()) * np.sqrt(len(some)) / float(periods.sum())
    return 1.0 / period_s, sd / period_s**2


def _lines(channel: Channel, period_s: float) -> Channel:
    """Return straight lines between the set-points; those that stayed longer are held before."""
    first = runs_of(channel).first
    begins = np.zeros(len(channel), dtype=np.bool_)
    begins[first] = True
    stamps = along(channel)
    corners = subset(channel, begins)
    at, values = along(corners), corners.values
    lasts = np.diff(at) > 1.5 * period_s
    knee = at[1:][lasts] - period_s
    at = np.concatenate([at, knee])
    values = np.concatenate([values, values[:-1][lasts]])
    order = np.argsort(at, kind="stable")
    return channel.with_values(np.interp(stamps, at[order], values[order]))


def _knew(channel: Channel, lines: Channel, speed: Channel, period_s: float) -> bool:
    """Return whether a speed follows the lines, and sooner than the held set-points allow."""
    row_s = row_period_s(channel)
    if period_s < (FEWEST_EVENTS - 0.5) * row_s:
        return False
    lags = np.arange(-1.0, 1.51, 0.05) * period_s
    by_lines = _misfit(lines, speed, lags)
    by_stairs = _misfit(channel, speed, lags, held=True)
    best = int(np.argmin(by_lines))
    soon = lags[best] + 0.75 * row_s < 0.5 * period_s
    return bool(
        soon and lags[best] > -0.5 * period_s and by_lines[best] < SPARSE_BETTER * by_stairs.min()
    )


def _misfit(inputs: Channel, speed: Channel, lags: Array, *, held: bool = False) -> Array:
    """Return the mean square of the speed less the input, that many seconds ago."""
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


def _finding(names: list[str], rates: list[tuple[float, float]]) -> Finding:
    rate_hz = float(np.median([rate for rate, _ in rates]))
    half = 1.96 * max(float(np.median([sd for _, sd in rates])), 0.01 * rate_hz)
    return data_fault(
        "held_samples",
        names,
        rate_hz,
        (rate_hz - half, rate_hz + half),
        "Hz",
        f"{listed(names)}: the log holds a set-point {rate_hz:.3g} times a second and repeats it,"
        " but the wheels followed what was sent between: record every set-point; straight lines"
        " were taken in their place.",
    )
