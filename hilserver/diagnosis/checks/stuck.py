"""Stuck channels: the same value in every row of a machine that moved."""

from dataclasses import replace
from typing import Final

import numpy as np

from hilserver.diagnosis.checks.support import alternates, data_fault, listed, measured_channels
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import FEWEST_SAMPLES, LARGE_STEP_RPM
from hilserver.measured.channels import GYRO, NAV_X, NAV_Y, YAW
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS
from hilserver.plant.parameters import RobotParameters

AXES: Final = {NAV_X: NAV_Y, NAV_Y: NAV_X}
TURNS: Final = (YAW, GYRO)


def find(log: MeasuredLog, _robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find channels that never change although they should, and leave them out.

    A simulated log without any noise is none of a sensor: there a robot that drives along an axis
    keeps its other coordinate to the bit.
    """
    names = measured_channels(log.channels)
    if not any(_is_noisy(log[name]) for name in names):
        return log, []
    stuck = [name for name in names if _is_constant(log[name]) and _should_change(log, name)]
    if not stuck:
        return log, []
    kept = {name: channel for name, channel in log.channels.items() if name not in stuck}
    text = (
        f"{listed(stuck)}: the same value in every row although the robot moved, as of a sensor"
        " that is stuck or not connected; it was left out."
    )
    return replace(log, channels=kept), [data_fault("held_samples", stuck, 0.0, None, "Hz", text)]


def _is_constant(channel: Channel) -> bool:
    return len(channel) >= FEWEST_SAMPLES and float(np.ptp(channel.values)) == 0.0


def _is_noisy(channel: Channel) -> bool:
    """Return whether a channel goes up and down from row to row."""
    steps = np.diff(channel.values)
    return len(steps) >= FEWEST_SAMPLES and alternates(steps)


def _should_change(log: MeasuredLog, name: str) -> bool:
    """Return whether the machine moved in a way that a channel shows."""
    if name in AXES:
        other = log.channels.get(AXES[name])
        known = other is not None and (_is_noisy(other) or _is_constant(other))
        return known and any(_range(log, wheel) > LARGE_STEP_RPM for wheel in WHEELS)
    if name in TURNS:
        return max(_range(log, "fl", "fr"), _range(log, "rl", "rr")) > LARGE_STEP_RPM
    _, _, wheel_part = name.partition("wheel.")
    wheel, _, quantity = wheel_part.partition(".")
    return quantity in ("speed_rpm", "duty_pct") and _range(log, wheel) > LARGE_STEP_RPM


def _range(log: MeasuredLog, *wheels: str) -> float:
    """Return by how much the speed of a wheel varies, or the turn that two wheels make [rpm].

    As commanded; as measured where no set-point is known. Right wheels are mirrored.
    """
    values = []
    for wheel in wheels:
        wanted = (f"wheel.{wheel}.setpoint_rpm", f"wheel.{wheel}.speed_rpm")
        channel = next((log[name] for name in wanted if name in log and len(log[name])), None)
        if channel is None:
            return 0.0
        values.append(channel.values)
    if len({len(v) for v in values}) > 1:
        return 0.0
    return float(np.ptp(np.sum(values, axis=0)))
