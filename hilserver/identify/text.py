"""Results of an identification as lines of text and as values for JSON."""

import math
from collections.abc import Iterable, Sequence
from dataclasses import asdict
from typing import Any

from hilserver.identify.consistency import Check
from hilserver.identify.dead_zone import DeadZone
from hilserver.identify.estimates import Estimate
from hilserver.identify.resting_noise import ChannelNoise
from hilserver.identify.rotation import RotationGain
from hilserver.identify.step_response import StepResponse
from hilserver.identify.update_rate import RateComparison, UpdateRate

SCHEMA = "hilserver.identify/1"


def number(
    estimate: Estimate | None, *, scale: float = 1.0, unit: str | None = None
) -> str:
    """Return a value with its interval and unit."""
    if estimate is None:
        return "not identified"
    unit = estimate.unit if unit is None else unit
    shown = "" if unit == "1" else f" {unit}"
    value = f"{estimate.value * scale:.4g}"
    if estimate.ci95 is None:
        return f"{value}{shown} (too little data for an interval)"
    low, high = (f"{limit * scale:.4g}" for limit in estimate.ci95)
    return f"{value}{shown}, 95 %: {low} .. {high}"


def rotation_lines(gain: RotationGain, checks: Sequence[Check]) -> list[str]:
    """Return K_om and the checks of 5.2.1."""
    marks = {True: "yes", False: "NO", None: "cannot tell"}
    return [
        f"yaw rate from {gain.channel}; configured K_om {gain.configured:.4g} 1/m",
        f"K_om, unsteady speeds      {number(gain.unsteady)}",
        f"K_om, steady speeds        {number(gain.steady)}"
        + (
            ""
            if gain.steady is None
            else f" ({gain.steady_share:.0%} of the samples, zone {gain.zone_rpm:g} rpm)"
        ),
        f"K_om, lag taken out        {number(gain.without_lag)}",
        f"lag of the yaw rate        {number(gain.lag_s, scale=1e3, unit='ms')}",
        *(
            f"{check.name + '?':<26} {marks[check.passed]}: {check.text}"
            for check in checks
        ),
        *_flags(gain.flags),
    ]


def step_lines(found: StepResponse) -> list[str]:
    """Return Strejc's reading and the two fits."""
    if found.strejc.order > 1:
        graphical = (
            f"order {found.strejc.order}, T = {found.strejc.time_constant_s:.4g} s"
        )
    else:
        graphical = "below order 2: see the two time constants"
    tangent = found.tangent
    return [
        f"{found.steps} steps of {found.input}, wheels {', '.join(found.wheels)}",
        f"tangent at the inflection  T_u = {tangent.delay_s:.4g} s, T_n = {tangent.rise_s:.4g} s, "
        f"T_u/T_n = {tangent.ratio:.3f}",
        f"Strejc, from the tangent   {graphical}",
        f"Strejc, from two points    T1 = {found.two_point_s[0]:.4g} s, "
        f"T2 = {found.two_point_s[1]:.4g} s",
        f"fit, order {found.order}               T = {number(found.time_constant)}; "
        f"gain {number(found.chain_gain)}; residual {found.rms_rpm[0]:.3g} rpm rms",
        f"fit, two time constants    T1 = {number(found.t1)}; T2 = {number(found.t2)}; "
        f"gain {number(found.gain)}; residual {found.rms_rpm[1]:.3g} rpm rms",
        *_flags(found.flags),
    ]


def rate_lines(
    rates: Sequence[UpdateRate], comparisons: Sequence[RateComparison]
) -> list[str]:
    """Return periods in ascending order, rises, and which logs can be distinguished."""
    lines = []
    for rate in sorted(rates, key=lambda rate: rate.period_s.value):
        rises = "; ".join(
            f"{rise.wheel} {number(rise.rise_s, scale=1e3, unit='ms')}"
            for rise in rate.rises
        )
        period = number(rate.period_s, scale=1e3, unit="ms")
        lines += [
            f"{rate.file}",
            f"  update period  {period}",
            f"  rise to 63 %   {rises}",
        ]
    for pair in comparisons:
        if pair.distinguishable:
            verdict = "is faster than"
        else:
            verdict = "not distinguishable from"
        lines.append(f"{pair.faster} {verdict} {pair.slower} (p = {pair.p_value:.2g})")
    return lines


def zone_lines(zones: Iterable[DeadZone]) -> list[str]:
    """Return the dead zone of every wheel."""
    return [
        f"{zone.wheel}: at rest from {number(zone.lower_pct)} to {number(zone.upper_pct)}"
        + (
            f"; {zone.held_rows} rows only repeat an old speed"
            if zone.held_rows
            else ""
        )
        for zone in zones
    ]


def noise_lines(channels: Iterable[ChannelNoise]) -> list[str]:
    """Return a table of noise models."""
    lines = [
        f"{'channel':<24}{'white sd':>11}{'OU sd':>11}{'tau [s]':>9}{'tail dof':>10}{'samples':>9}"
    ]
    for row in channels:
        noise = row.noise
        tau = f"{noise.ou_tau_s:.3g}" if noise.ou_sd else "-"
        dof = "normal" if math.isinf(noise.tail_dof) else f"{noise.tail_dof:g}"
        lines.append(
            f"{row.channel:<24}{noise.white_sd:>11.4g}{noise.ou_sd:>11.4g}{tau:>9}{dof:>10}"
            f"{row.samples:>9}"
        )
    return lines


def as_json(kind: str, found: object) -> dict[str, Any]:
    """Return a result as values; infinite values and NaN become null."""
    return {"schema": SCHEMA, "identified": kind, **_plain(found)}


def as_list(found: Iterable[object]) -> list[Any]:
    """Return several results as values."""
    return [_plain(item) for item in found]


def _plain(value: Any) -> Any:
    if hasattr(value, "__dataclass_fields__"):
        return _plain(asdict(value))
    if isinstance(value, dict):
        return {key: _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None
    return value


def _flags(flags: Iterable[str]) -> list[str]:
    return [f"! {flag}" for flag in flags]
