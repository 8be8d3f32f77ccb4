"""What the numbers of a foreign log say about what they are, whatever their names.

A robot's channels show one motion. What turns as the difference of its wheels does is a turn rate,
what moves as their sum does is its pose; a marker that a camera sees is neither.
"""

import contextlib
import csv
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
        t = self.t[::step]
        dt = np.diff(t)
        dx = np.diff(self.values[::step])
        good = dt > 0.0
        return Samples(t[1:][good], dx[good] / dt[good])


UNSEEN: Final = Samples(np.empty(0), np.empty(0))


def samples(t: Array, values: Array) -> Samples:
    """Return a channel without what is missing."""
    there = np.isfinite(t) & np.isfinite(values)
    t = t[there]
    values = values[there]
    order = np.argsort(t, kind="stable")
    return Samples(t[order], values[order])


def speed(x: Samples, y: Samples) -> Samples:
    """Return how fast a position moves."""
    both = Samples(x.t, np.interp(x.t, *y)) if len(y.t) else y
    along = x.rate
    across = both.rate
    if len(along.t) != len(across.t):
        return UNSEEN
    return Samples(along.t, np.hypot(along.values, across.values))


def turning(yaw: Samples) -> Samples:
    """Return how fast a heading turns, which may be in degrees."""
    largest = float(np.abs(yaw.values).max(initial=0.0))
    period = 360.0 if largest > 2.0 * np.pi + 1.0 else 2.0 * np.pi
    whole = np.unwrap(yaw.values, period=period)
    return Samples(yaw.t, whole).rate


def alike(one: Samples, other: Samples) -> float:
    """Return the correlation of two channels, averaged over a few steps; 0 if nothing is to see."""
    if not (one.moves and other.moves):
        return 0.0
    begin = max(one.t[0], other.t[0])
    end = min(one.t[-1], other.t[-1])
    if end <= begin:
        return 0.0
    t = np.linspace(begin, end, GRID)
    window = np.ones(5) / 5.0
    a = np.convolve(np.interp(t, *one), window, mode="valid")
    b = np.convolve(np.interp(t, *other), window, mode="valid")
    is_flat = np.ptp(a) == 0.0 or np.ptp(b) == 0.0
    return 0.0 if is_flat else float(np.corrcoef(a, b)[0, 1])


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
        ahead = np.abs(self.forward.values)
        return alike(pace, Samples(self.forward.t, ahead))


def motion_of(left: Samples, right: Samples, source: str) -> Motion | None:
    """Return the motion that two sides show; None if they stand still.

    Whether right wheels are mirrored shows in the sides themselves: robots mostly drive ahead.
    """
    if not (left.moves and right.moves):
        return None
    both = np.interp(left.t, *right)
    product = float(np.mean(left.values * both))
    if product < 0.0:
        both = -both
    forward = Samples(left.t, left.values + both)
    turn = Samples(left.t, both - left.values)
    return Motion(forward, turn, source)


def table_samples(
    path: Path, layout: CsvLayout, time: str | None
) -> dict[str, Samples]:
    """Return the channels of a CSV file by name, as far as they hold numbers."""
    rows: list[list[str]] = []
    with path.open(encoding="utf-8-sig", errors="replace", newline="") as file:
        begin = layout.data_row - 1
        lines = islice(file, begin, begin + MOST_ROWS)
        reader = csv.reader(lines, delimiter=layout.separator)
        with contextlib.suppress(csv.Error):  # what follows is left to the reader
            rows.extend(reader)
    step = max(1, len(rows) // (10 * GRID))
    width = len(layout.header)
    full = [row for row in rows[::step] if len(row) >= width]

    columns: dict[str, Array] = {}
    for name, *texts in zip(layout.header, *full, strict=False):
        # Numbers, times of every form as nanoseconds, NaN for others.
        found = np.full(len(texts), np.nan)
        for place, text in enumerate(texts):
            point = text if layout.separator == COMMA else text.replace(COMMA, ".")
            try:
                found[place] = float(point)
            except ValueError:
                # A column of other texts ends the attempt with its first row.
                is_time = place == 0 or np.isfinite(found[place - 1])
                ns = stamp_ns(text) if is_time else None
                found[place] = np.nan if ns is None else ns
        columns[name] = found
    t = np.arange(len(full), dtype=np.float64)
    stamps = columns.get(str(time), t)
    if np.isfinite(stamps).any():
        t = stamps
    return {name: samples(t, values) for name, values in columns.items()}
