"""The noise of every sensor while the robot stands still, when no model can be wrong."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.noise.fitting import fit_noise
from hilserver.diagnosis.noise.whitening import NoiseModel
from hilserver.errors import LogError
from hilserver.identify.wheels import at, files, present
from hilserver.measured.data import MeasuredLog

RESTING_RPM: Final = 1.0
RESTED_S: Final = 0.5
STAND_S: Final = 5.0
_SAMPLES_MIN = 50
_INPUTS = (".setpoint_rpm", ".duty_pct")


@dataclass(frozen=True)
class ChannelNoise:
    """One channel's noise."""

    channel: str
    samples: int
    noise: NoiseModel


def identify_noise(log: MeasuredLog, *, everywhere: bool = False) -> list[ChannelNoise]:
    """Fit white + Ornstein-Uhlenbeck noise with tails to every measured channel.

    `everywhere`: use the whole log, because its values are errors already or the robot never moved.
    LogError if the robot never stands still for 5 s.
    """
    found = []
    for name, channel in sorted(log.channels.items()):
        if name.endswith(_INPUTS):
            continue
        stretches: list[tuple[Array, Array]] = []
        for span in range(len(log.spans)):
            t_s, values = channel.of(span)
            angles = name.endswith("yaw_rad")
            values = np.unwrap(values) if angles else values
            if everywhere:
                stretches.append((t_s, values))
            else:
                stretches += _resting(log, span, t_s, values)
        samples = sum(len(t_s) for t_s, _ in stretches)
        if samples >= _SAMPLES_MIN:
            found.append(ChannelNoise(name, samples, fit_noise(stretches)))
    if not found:
        raise LogError(
            f"{files(log)}: the robot never stands still for {STAND_S:g} s with a sensor in the"
            " log; record a minute at rest, or use --everywhere if the values are already errors"
        )
    return found


def _resting(
    log: MeasuredLog, span: int, t_s: Array, values: Array
) -> list[tuple[Array, Array]]:
    """Return the stretches in which no wheel has turned since the settling time."""
    wheels = present(log, "speed_rpm")
    if not wheels:
        return []
    still = np.ones(len(t_s), dtype=bool)
    for wheel in wheels:
        channel = log[f"wheel.{wheel}.speed_rpm"]
        own_s, speed = channel.of(span)
        if not len(own_s):
            return []
        turning = np.abs(speed) > RESTING_RPM
        last_s = np.maximum.accumulate(np.where(turning, own_s, -np.inf))
        index = np.searchsorted(own_s, t_s, side="right") - 1
        rested_s = t_s - last_s[np.maximum(index, 0)]
        still &= (index >= 0) & (rested_s >= RESTED_S)
        if f"wheel.{wheel}.setpoint_rpm" in log:
            aim = at(log[f"wheel.{wheel}.setpoint_rpm"], span, t_s, hold=True)
            still &= ~(np.abs(aim) > 0.0)
    edges = np.flatnonzero(np.diff(still.astype(np.int8), prepend=0, append=0))
    pieces = []
    for first, end in zip(edges[::2], edges[1::2], strict=True):
        if t_s[end - 1] - t_s[first] >= STAND_S:
            pieces.append((t_s[first:end], values[first:end]))
    return pieces
