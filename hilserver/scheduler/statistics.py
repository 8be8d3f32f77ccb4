"""The scheduler's statistics in Python: figures per slice, all of the same instant.

Words: *wake latency* is the actual minus the planned start; *execution* the work of the slice,
measured before the wait; *margin* is deadline minus end (positive is good); a *missed tick* is a
planned start that was given up; *jitter* is the standard deviation and range of the wake latency in
the last complete window (1000 runs or 1 s).

The deadline of a compiled slice is the next planned tick, because all of them share one thread; the
deadline of a communication slice is its own next planned start.
"""

import math
import mmap
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilserver.scheduler import statistics_rows as rows
from hilserver.scheduler.slices import Slice

words_needed = rows.words_needed
_READ_ROUNDS, _READ_PAUSE_S = 1000, 0.001


@dataclass(frozen=True, slots=True)
class LatencyWindow:
    """Wake latency over the last complete window [ns]; NaN before the first.

    In the standard deviation latencies above 90 ms count as 90 ms.
    """

    count: int
    mean_ns: float
    deviation_ns: float
    low_ns: float
    high_ns: float


@dataclass(frozen=True, slots=True)
class SliceFigures:
    """The figures of one slice since the last reset; all times in ns."""

    name: str
    period_ns: int
    count: int
    latency_sum_ns: int
    latency_max_ns: int
    latency_max_tick: int
    latency_last_ns: int
    execution_sum_ns: int
    execution_max_ns: int
    execution_max_tick: int
    execution_last_ns: int
    margin_min_ns: int | None  # the smallest margin; None before the first run
    margin_min_tick: int
    margin_last_ns: int
    late_wakes: int
    long_runs: int
    missed_ticks: int
    window: LatencyWindow
    # shape (N_BUCKETS,); 1-2-5 histograms, see `hilserver.compiled.histogram`; not cumulated
    latency_counts: NDArray[np.int64]
    execution_counts: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TickFigures:
    """Figures of the tick as a whole."""

    missed_ticks: int  # planned starts of the base period that were given up
    # simulated over real time while running, in the last complete second and since the reset; NaN
    # before
    real_time_factor: float
    real_time_factor_total: float


_PLAIN = [
    f.name for f in fields(SliceFigures) if f.type is int and f.name != "period_ns"
]
"""Figures taken unchanged from words of a row."""


class Statistics:
    """Reads (and resets) a statistics array; the loop fills it.

    Parameters
    ----------
    slices
        Compiled slices first, then the communication slices: the order of the rows.
    base_period_ns
        The base period.
    array
        int64, at least ``words_needed(len(slices), linear_bins)`` long, zeroed or left by an
        earlier run; None: one is allocated.
    linear_bins
        Length of the linear histogram of the tick's wake latency in 1 us bins; 0: none.
    """

    def __init__(
        self,
        slices: Sequence[Slice],
        base_period_ns: int,
        array: NDArray[np.int64] | None = None,
        linear_bins: int = 0,
    ) -> None:
        needed = rows.words_needed(len(slices), linear_bins)
        if array is None:
            array = np.zeros(needed, dtype=np.int64)
        if array.dtype != np.int64 or array.ndim != 1 or len(array) < needed:
            raise ValueError(
                f"the statistics need a flat int64 array of {needed} words"
            )
        array[:needed] = 0
        head = rows.TickHead.of(array)
        head.generation, head.n_rows, head.n_linear = 1, len(slices), linear_bins
        head.base_period = base_period_ns
        for index, part in enumerate(slices):
            rows.SliceRow.of(array, row_offset(index)).period_ticks = part.period_ticks
        rows.publish_magic(array)
        self._adopt(array, [part.name for part in slices])

    def _adopt(self, array: NDArray[np.int64], names: list[str]) -> None:
        self.array, self._head = array, rows.TickHead.of(array)
        self._offsets = {name: row_offset(index) for index, name in enumerate(names)}

    @classmethod
    def attach(
        cls, array: NDArray[np.int64], names: Sequence[str] | None = None
    ) -> "Statistics":
        """Read the array of another process; `names` in the order of its rows (None: "0", "1").

        ValueError if the array holds no statistics (yet), or those of other slices.
        """
        if len(array) < rows.N_HEAD or array[rows.MAGIC] != rows.MAGIC_NUMBER:
            raise ValueError("this array holds no scheduler statistics")
        held = rows.TickHead.of(array).n_rows
        if names is None:
            names = [str(index) for index in range(held)]
        if len(names) != held:
            raise ValueError(f"the statistics hold {held} slices, not {len(names)}")
        attached = cls.__new__(cls)
        attached._adopt(array, list(names))
        return attached

    @property
    def names(self) -> list[str]:
        """The slices, in the order of the rows."""
        return list(self._offsets)

    @property
    def thread_id(self) -> int:
        """The operating system's number of the pacing thread; 0: not started, or virtual time."""
        return int(self._head.thread_id)

    @thread_id.setter
    def thread_id(self, number: int) -> None:
        self._head.thread_id = number

    def reset(self) -> None:
        """Restart all counts; safe at any time, from any process that maps the array."""
        self._head.generation += 1

    def slice(self, name: str) -> SliceFigures:
        """Return the figures of one slice."""
        words = self._read(self._offsets[name], rows.N_ROW)
        row = rows.SliceRow.of(words)
        if row.seen_generation != self._head.generation:
            rows.clear_row(words, 0)
        return _figures(name, int(row.period_ticks * self._head.base_period), row)

    @property
    def tick(self) -> TickFigures:
        """The figures of the tick as a whole."""
        head = rows.TickHead.of(self._read(0, rows.N_HEAD))
        if head.seen_generation != head.generation:
            return TickFigures(0, math.nan, math.nan)
        return TickFigures(
            missed_ticks=int(head.missed_ticks),
            real_time_factor=_ratio(
                head.last_span_ticks * head.base_period, head.last_span_ns
            ),
            real_time_factor_total=_ratio(
                head.run_ticks * head.base_period, head.run_ns
            ),
        )

    @property
    def linear_counts(self) -> NDArray[np.int64]:
        """A copy of the tick's linear histogram of the wake latency, one bin per us."""
        first = row_offset(int(self._head.n_rows))
        whole = self._read(0, first + int(self._head.n_linear))
        counts, head = whole[first:], rows.TickHead.of(whole)
        if head.seen_generation != head.generation:
            counts[:] = 0
        return counts

    def _read(self, offset: int, length: int) -> NDArray[np.int64]:
        out = np.empty(length, dtype=np.int64)
        for _ in range(_READ_ROUNDS):
            if rows.read_row(self.array, offset, out):
                return out
            # the writer was preempted, or its core stolen, in the middle
            time.sleep(_READ_PAUSE_S)
        raise RuntimeError(
            "the statistics are half written: their writer was stopped or has died"
        )


def map_statistics(path: Path, n_words: int | None = None) -> NDArray[np.int64]:
    """Map a file of int64 words shared by processes.

    Parameters
    ----------
    path
        On a memory file system (/dev/shm); elsewhere writing back to disk would stop the loop.
    n_words
        Create the file with this length; None: map the existing one.
    """
    if n_words is not None:
        path.touch(mode=0o600)
        os.truncate(path, 8 * n_words)
    with path.open("r+b") as file:
        return np.frombuffer(mmap.mmap(file.fileno(), 0), dtype=np.int64)


def row_offset(index: int) -> int:
    """Return where the row of slice number `index` begins."""
    return rows.N_HEAD + index * rows.N_ROW


def _ratio(part: int, whole: int) -> float:
    return float(part / whole) if whole else math.nan


def _figures(name: str, period_ns: int, row: rows.SliceRow) -> SliceFigures:
    lowest_ns = int(row.margin_min_ns)
    return SliceFigures(
        name=name,
        period_ns=period_ns,
        margin_min_ns=None if lowest_ns == rows.NEVER else lowest_ns,
        window=_window(row.last_window),
        latency_counts=row.latency_counts.copy(),
        execution_counts=row.execution_counts.copy(),
        **{name: int(row[name]) for name in _PLAIN},
    )


def _window(window: rows.Window) -> LatencyWindow:
    count = int(window.count)
    if count == 0:
        return LatencyWindow(0, math.nan, math.nan, math.nan, math.nan)
    total, squares = int(window.total), int(window.squares)
    variance = (count * squares - total * total) / count**2
    return LatencyWindow(
        count=count,
        mean_ns=total / count,
        deviation_ns=math.sqrt(variance),
        low_ns=float(window.low),
        high_ns=float(window.high),
    )
