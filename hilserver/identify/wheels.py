"""Wheel channels of a log at given stamps."""

from collections.abc import Callable, Sequence

import numpy as np

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.measured.channels import SIDES
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.layout import WHEELS


def present(
    log: MeasuredLog, quantity: str, wheels: Sequence[str] = WHEELS
) -> list[str]:
    """Return the wheels that have this channel, for example ``speed_rpm``."""
    return [wheel for wheel in wheels if f"wheel.{wheel}.{quantity}" in log]


def need(log: MeasuredLog, *names: str) -> None:
    """Refuse a log that lacks a channel; LogError names the file and the channels."""
    missing = [name for name in names if name not in log]
    if missing:
        raise LogError(
            f"{files(log)}: no channel {', '.join(missing)}; record it, or map its column"
        )


def files(log: MeasuredLog) -> str:
    """Return the names of the files for a message."""
    return ", ".join(source.file for source in log.sources)


def at(channel: Channel, span: int, t_s: Array, *, hold: bool = False) -> Array:
    """Return a channel's values in a span, interpolated linearly, or held like a set-point.

    NaN outside the span's samples.
    """
    own_t, values = channel.of(span)
    if not len(own_t):
        return np.full(len(t_s), np.nan)
    if hold:
        index = np.searchsorted(own_t, t_s, side="right") - 1
        before = values[np.maximum(index, 0)]
        return np.where(index >= 0, before, np.nan)
    return np.interp(t_s, own_t, values, left=np.nan, right=np.nan)


def per_span(
    log: MeasuredLog, name: str, function: Callable[[int, Array], Array]
) -> Array:
    """Return `function(span, stamps)` at all samples of a channel, joined."""
    channel = log[name]
    parts = [function(span, channel.of(span)[0]) for span in range(len(log.spans))]
    return np.concatenate(parts)


def side_sum_rpm(log: MeasuredLog, span: int, t_s: Array) -> Array:
    """Return w_L + w_R [rpm]; a side is the mean of its measured wheels."""
    total = np.zeros(len(t_s))
    for side in SIDES:
        wheels = present(log, "speed_rpm", side)
        speeds_rpm = [at(log[f"wheel.{w}.speed_rpm"], span, t_s) for w in wheels]
        total += np.mean(speeds_rpm, axis=0)
    return total
