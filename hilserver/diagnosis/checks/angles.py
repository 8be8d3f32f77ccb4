"""Wheel angles: those that wrap are made continuous, those without a speed become speeds."""

import math
from dataclasses import replace

import numpy as np

from hilserver.diagnosis.checks.support import reach
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import FEWEST_CHANGES, NEARLY_ALL
from hilserver.measured.channels import SPEEDS
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.measured.resolution import step_of
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM, RPM_PER_RAD_S


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Unwrap wheel angles, and replace them by speeds if no speed was recorded.

    Neither is a fault of the log: notices give the places.
    """
    speed_of = dict(
        zip((f"wheel.{wheel}.angle_rad" for wheel in WHEELS), SPEEDS, strict=True)
    )
    notices: list[str] = []
    for name in (n for n in speed_of if n in log):
        size = _wrap(log[name], robot.max_rpm * RAD_S_PER_RPM)
        if size:
            log = log.with_channels({name: _unwrap(log[name], size)})
            notices.append(
                f"{name}: the angle wraps at {size:.4g} rad; it was unwrapped"
            )
    alone = {
        a: s
        for a, s in speed_of.items()
        if a in log and s not in log and len(log[a]) > 1
    }
    if alone:
        speeds = {speed: _changing(log[angle]) for angle, speed in alone.items()}
        log = replace(log.without(alone).with_channels(speeds), made=frozenset(speeds))
        made = f"no speed was recorded of {', '.join(alone)}: it is made of how the angles change"
        notices.append(made)
    return replace(log, notices=(*log.notices, *notices)), []


def _wrap(channel: Channel, fastest_rad_s: float) -> float:
    """Return by how much the angle jumps back; 0 if it does not.

    A jump is faster than the wheel can turn and crosses most of the range of all readings. Its size
    is one turn, or that of a counter of whole bits, unless the jumps show otherwise.
    """
    inside = np.diff(channel.span) == 0
    step, dt = np.diff(channel.values)[inside], np.diff(channel.t_s)[inside]
    range_rad = reach(channel.values)
    jumps = np.abs(step) > np.maximum(fastest_rad_s * dt, 0.5 * range_rad)
    calm = step[~jumps]
    if not jumps.any() or len(calm) < FEWEST_CHANGES:
        return 0.0
    steady = np.interp(np.flatnonzero(jumps), np.flatnonzero(~jumps), calm)
    sizes = np.abs(step[jumps] - steady)
    size = float(np.median(sizes))
    if np.mean(np.abs(sizes - size) < 0.2 * size) < NEARLY_ALL:
        return 0.0
    # what a steady turn leaves
    usual = np.abs(calm[1:-1] - 0.5 * (calm[:-2] + calm[2:]))
    unsure = 3.0 * float(np.quantile(usual, 0.9)) / np.sqrt(len(sizes)) + 1e-9
    quantum, _ = step_of(channel.values)
    bits = quantum * np.exp2(np.rint(np.log2(size / quantum))) if quantum else math.tau
    likely = ((math.tau, unsure), (bits, unsure + quantum))
    return next(
        (whole for whole, beside in likely if abs(size - whole) <= beside), size
    )


def _unwrap(channel: Channel, size: float) -> Channel:
    values = channel.values.copy()
    for span in np.unique(channel.span):
        first, end = np.searchsorted(channel.span, [span, span + 1])
        values[first:end] = np.unwrap(values[first:end], period=size)
    return channel.with_values(values)


def _changing(angle: Channel) -> Channel:
    """Return the speed [rpm] between every two samples of a span, at the time midway."""
    inside = np.flatnonzero(np.diff(angle.span) == 0)
    dt = np.diff(angle.t_s)[inside]
    speed = np.diff(angle.values)[inside] / dt * RPM_PER_RAD_S
    return Channel(angle.t_s[inside] + 0.5 * dt, speed, angle.span[inside])
