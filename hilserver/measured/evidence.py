"""What the numbers of a foreign log say about what they are, whatever their names.

A robot's channels show one motion. What turns as the difference of its wheels does is a turn rate,
what moves as their sum does is its pose; a marker that a camera sees is neither.
"""

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from hilserver.arrays import Array
from hilserver.logs.csv_layout import CsvLayout
from hilserver.logs.csv_times import COMMA, stamp_ns

MOST_ROWS: Final = 100_000  # of a table that are looked at
FEWEST: Final = 20  # samples that show anything
GRID: Final = 400  # instants at which two channels are compared
LEAST: Final = 0.3  # correlation of what shows the same motion
CLEARLY: Final = 0.3  # more correlation that decides against a name


class Samples(NamedTuple):
    """The finite samples of a channel; times rise."""

    # shape (n,)
    t: Array
    values: Array

    @property
    def moves(self) -> bool:
        """Whether there is enough that changes."""
        return len(self.values) >= FEWEST and float(np.ptp(self.values)) > 0.0

    @property
    def rate(self) -> "Samples":
        """The derivative, taken over steps long enough to show more than rounding."""
        step = max(1, len(self.t) // GRID)
        t, x = self.t[::step], self.values[::step]
        dt = np.diff(t)
        good = dt > 0.0
        return Samples(t[1:][good], np.diff(x)[good] / dt[good])


UNSEEN: Final = Samples(np.empty(0), np.empty(0))


def samples(t: Array, values: Array) -> Samples:
    """Return a channel without what is missing."""
    there = np.isfinite(t) & np.isfinite(values)
    t, values = t[there], values[there]
    order = np.argsort(t, kind="stable")
    return Samples(t[order], values[order])


def speed(x: Samples, y: Samples) -> Samples:
    """Return how fast a position moves."""
    both = Samples(x.t, np.interp(x.t, *y)) if len(y.t) else y
    along, across = x.rate, both.rate
    if len(along.t) != len(across.t):
        return UNSEEN
    return Samples(along.t, np.hypot(along.values, across.values))


def turning(yaw: Samples) -> Samples:
    """Return how fast a heading turns, which may be in degrees."""
    is_deg = len(yaw.values) > 0 and float(np.abs(yaw.values).max()) > 7.0
    period = 360.0 if is_deg else 2.0 * np.pi
    return Samples(yaw.t, np.unwrap(yaw.values, period=period)).rate


def alike(one: Samples, other: Samples) -> float:
    """Return the correlation of two channels, averaged over a few steps; 0 if nothing is to see."""
    if not (one.moves and other.moves):
        return 0.0
    begin, end = max(one.t[0], other.t[0]), min(one.t[-1], other.t[-1])
    if end <= begin:
        return 0.0
    t = np.linspace(begin, end, GRID)
    window = np.ones(5) / 5.0
    a, b = (np.convolve(np.interp(t, *x), window, mode="valid") for x in (one, other))
    if np.ptp(a) == 0.0 or np.ptp(b) == 0.0:
        return 0.0
    return float(np.corrcoef(a, b)[0, 1])


@dataclass(frozen=True, slots=True)
class Motion:
    """What the wheels, or the commands, say of the motion."""

    forward: Samples
    turn: Samples
    source: str

    def turns(self, channel: Samples) -> float:
        """Return how well a rate fits the turning, of either sign."""
        return abs(alike(channel, self.turn))

    def moves(self, pace: Samples) -> float:
        """Return how well a pace, which has no sign, fits the motion ahead."""
        return alike(pace, Samples(self.forward.t, np.abs(self.forward.values)))


def motion_of(left: Samples, right: Samples, source: str) -> Motion | None:
    """Return the motion that two sides show; None if they stand still.

    Whether right wheels are mirrored shows in the sides themselves: robots mostly drive ahead.
    """
    if not (left.moves and right.moves):
        return None
    both = np.interp(left.t, *right)
    mirrored = -1.0 if float(np.mean(left.values * both)) < 0.0 else 1.0
    forward = Samples(left.t, left.values + mirrored * both)
    turn = Samples(left.t, mirrored * both - left.values)
    return Motion(forward, turn, source) if forward.moves or turn.moves else None


def table_samples(
    path: Path, layout: CsvLayout, time: str | None
) -> Mapping[str, Samples]:
    """Return the channels of a CSV file by name, as far as they hold numbers."""
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        lines = islice(file, layout.data_row - 1, layout.data_row - 1 + MOST_ROWS)
        rows = list(
            csv.reader(
                (line.replace("\0", "") for line in lines), delimiter=layout.separator
            )
        )
    step = max(1, len(rows) // (10 * GRID))
    width = len(layout.header)
    full = [row for row in rows[::step] if len(row) >= width]
    columns = dict(zip(layout.header, zip(*full, strict=False), strict=False))
    t = np.arange(len(full), dtype=np.float64)
    if time in columns:
        stamps = _numbers(columns[str(time)], layout.separator)
        t = stamps if np.isfinite(stamps).any() else t
    return {
        name: samples(t, _numbers(texts, layout.separator))
        for name, texts in columns.items()
    }


def _numbers(texts: Sequence[str], separator: str) -> Array:
    found = np.full(len(texts), np.nan)
    for row, text in enumerate(texts):
        point = text if separator == COMMA else text.replace(COMMA, ".")
        try:
            found[row] = float(point)
        except ValueError:
            ns = stamp_ns(text) if row == 0 or np.isfinite(found[row - 1]) else None
            found[row] = np.nan if ns is None else ns
    return found
