"""Wheel angles: those that jump back are made continuous, those that stand alone become speeds."""

from dataclasses import replace

import numpy as np

from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import UNITY
from hilserver.measured.channels import SPEEDS
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM, RPM_PER_RAD_S


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Unwrap wheel angles, and put speeds in their place where none was recorded.

    Neither is a fault of the log: notices give the places.
    """
    speed_of = dict(zip((f"wheel.{wheel}.angle_rad" for wheel in WHEELS), SPEEDS, strict=True))
    notices: list[str] = []
    for name in (n for n in speed_of if n in log):
        size = _wrap(log[name], UNITY * robot.max_rpm * RAD_S_PER_RPM)
        if size:
            log = log.with_channels({name: _unwrap(log[name], size)})
            notices.append(f"{name}: the angle wraps at {size:.4g} rad; it was made continuous")
    alone = {a: s for a, s in speed_of.items() if a in log and s not in log and len(log[a]) > 1}
    if alone:
        speeds = {speed: _changing(log[angle]) for angle, speed in alone.items()}
        log = log.without(alone).with_channels(speeds)
        made = f"no speed was recorded of {', '.join(alone)}: it is made of how the angles change"
        notices.append(made)
    return replace(log, notices=(*log.notices, *notices)), []


def _wrap(channel: Channel, fastest_rad_s: float) -> float:
    """Return by how much the angle jumps back; 0 if it does not."""
    inside = np.diff(channel.span) == 0
    step, dt = np.diff(channel.values)[inside], np.diff(channel.t_s)[inside]
    jumps = np.flatnonzero(np.abs(step) > fastest_rad_s * dt + 1.0)
    jumps = jumps[(jumps > 0) & (jumps < len(step) - 1)]
    if not len(jumps):
        return 0.0
    extra = step[1:-1] - 0.5 * (step[:-2] + step[2:])  # what a steady turn does not explain
    sizes = np.abs(extra[jumps - 1])
    size = float(np.median(sizes))
    near = np.unique(np.concatenate([jumps - 2, jumps - 1, jumps]).clip(0, len(extra) - 1))
    usual = np.abs(np.delete(extra, near))
    unsure = 3.0 * float(np.quantile(usual, 0.9)) / np.sqrt(len(jumps)) if usual.size else 0.0
    if abs(size - 2.0 * np.pi) <= unsure + 1e-9:
        size = 2.0 * np.pi
    return size if np.all(np.abs(sizes / size - 1.0) < 0.2) else 0.0


def _unwrap(channel: Channel, size: float) -> Channel:
    values = channel.values.copy()
    for span in np.unique(channel.span):
        first, end = np.searchsorted(channel.span, [span, span + 1])
        values[first:end] = np.unwrap(values[first:end], period=size)
    return channel.with_values(values)


def _changing(angle: Channel) -> Channel:
    """Return the speed [rpm] between every two samples of a span, in the middle between them."""
    inside = np.flatnonzero(np.diff(angle.span) == 0)
    dt = np.diff(angle.t_s)[inside]
    speed = np.diff(angle.values)[inside] / dt * RPM_PER_RAD_S
    return Channel(angle.t_s[inside] + 0.5 * dt, speed, angle.span[inside])
