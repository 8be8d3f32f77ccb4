"""Faults of the data: the machine is sound, the log is not."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np

from hilserver_injector.recipe import WHEELS, Recipe
from hilserver_injector.table import Table

RAD_S_PER_RPM = math.pi / 30.0


def _some(table: Table, channel: str | tuple[str, ...]) -> list[str]:
    """Return the columns whose name holds one of these words (``speed_rpm``, ``nav.``)."""
    words = (channel,) if isinstance(channel, str) else channel
    return [name for name in table.columns if any(word in name for word in words)]


def _sign_flip(table: Table, channel: Any, rng: np.random.Generator) -> None:
    for name in _some(table, channel):
        table.columns[name] = -table.columns[name]


def _unit(table: Table, given: Any, rng: np.random.Generator) -> None:
    channel, factor = given
    for name in _some(table, channel):
        table.columns[name] = factor * table.columns[name]


def _swapped_sides(table: Table, channel: Any, rng: np.random.Generator) -> None:
    """Left columns hold the right wheels and the other way round."""
    for a, b in (("fl", "fr"), ("rl", "rr")):
        left, right = f"wheel.{a}.{channel}", f"wheel.{b}.{channel}"
        table.columns[left], table.columns[right] = (
            -table.columns[right],
            -table.columns[left],
        )


def _held(table: Table, given: Any, rng: np.random.Generator) -> None:
    """Hold each sample of a channel until the next of its slower clock; the tag has its own."""
    channel, rate_hz = given
    group = np.floor(table.t_s * rate_hz + rng.random())
    first = np.searchsorted(group, group, side="left")
    for name in _some(table, channel):
        values = table.columns[name]
        if name.startswith("nav."):
            there = np.where(np.isfinite(values), np.arange(len(values)), -1)
            first = np.maximum.accumulate(there)
            values = np.append(values, np.nan)  # nothing to repeat before the first
        table.columns[name] = values[first]


def _interpolated(table: Table, rate_hz: Any, rng: np.random.Generator) -> None:
    """Join samples of the set-points at a slower rate by straight lines."""
    every = max(round(1.0 / rate_hz / float(np.median(np.diff(table.t_s)))), 1)
    for name in _some(table, "setpoint_rpm"):
        few = table.columns[name][::every]
        table.columns[name] = np.interp(table.t_s, table.t_s[::every], few)


def _setpoint_as_measurement(
    table: Table, given: Any, rng: np.random.Generator
) -> None:
    for wheel in WHEELS:
        copied = table.columns[f"wheel.{wheel}.setpoint_rpm"].copy()
        table.columns[f"wheel.{wheel}.speed_rpm"] = copied


def _dropouts(table: Table, given: Any, rng: np.random.Generator) -> None:
    """Repeat the sample before in bursts: the recorder lost what it should have written."""
    channel, share = given
    names, n = _some(table, channel), len(table.t_s)
    length = 15
    for k in np.flatnonzero(rng.random(n) < share / length):
        for name in names:
            table.columns[name][k : k + length] = table.columns[name][max(k - 1, 0)]


def _clock(table: Table, given: Any, rng: np.random.Generator) -> None:
    """Give one source an offset [s] and a drift; its samples get rows of their own."""
    channel, offset_s, drift = given
    names = _some(table, channel)
    moved = table.t_s * (1.0 + drift) + offset_s
    n = len(moved)
    times = np.concatenate([table.t_s, moved])
    order = np.argsort(times, kind="stable")
    keep = np.concatenate([np.ones(n, bool), np.isfinite(table.columns[names[0]])])[
        order
    ]
    empty = np.full(n, np.nan)
    for name, values in table.columns.items():
        both = [empty, values] if name in names else [values, empty]
        table.columns[name] = np.concatenate(both)[order][keep]
    rising = 2e-6 * np.arange(int(keep.sum()))  # no two rows with one stamp
    table.t_s = np.maximum.accumulate(times[order][keep] - rising) + rising


FAULTS: Mapping[str, Callable[[Table, Any, np.random.Generator], None]] = {
    "sign_flip": _sign_flip,
    "unit_error": _unit,
    "swapped_sides": _swapped_sides,
    "held_samples": _held,
    "interpolated_setpoint": _interpolated,
    "setpoint_as_measurement": _setpoint_as_measurement,
    "dropouts": _dropouts,
    "clock": _clock,
}


def apply(recipe: Recipe, table: Table, notes: dict[str, Any]) -> None:
    """Spoil the table as the recipe says."""
    rng = recipe.generator("faults")
    for name, given in recipe.faults.items():
        FAULTS[name](table, given, rng)
    if recipe.faults:
        notes["faults"] = dict(recipe.faults)
