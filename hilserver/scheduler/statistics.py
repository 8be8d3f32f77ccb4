"""What the scheduler has counted, for Python: figures per slice, of one consistent instant.

Words: *wake latency* is the actual minus the planned start; *execution* the work of the slice,
measured before the wait; *margin* deadline minus end (positive is good); a *missed tick* a planned
start that was given up; *jitter* the standard deviation and range of the wake latency in the last
complete window (1000 runs or 1 s).

The deadline of a compiled slice is the next planned tick, because all of them share one thread; the
deadline of a communication slice is its own next planned start.
"""

import math
import mmap
import os
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilserver.scheduler import statistics_rows as rows
from hilserver.scheduler.slices import Slice

words_needed = rows.words_needed
_READ_ROUNDS, _READ_PAUSE_S = 1000, 0.001


@dataclass(frozen=True, slots=True)
class Window:
    """Wake latency over the last complete window [ns]; NaN where there is none yet.

    The standard deviation takes latencies above 90 ms as 90 ms.
    """

    count: int
    mean_ns: float
    deviation_ns: float
    low_ns: float
    high_ns: float


@dataclass(frozen=True, slots=True)
class SliceFigures:
    """The figures of one slice since the last reset; all times in ns.

    Attributes
    ----------
    latency_counts, execution_counts : ndarray of int64, shape (N_BUCKETS,)
        1-2-5 histograms, see `hilserver.compiled.histogram`; not cumulated.
    margin_min_ns : int or None
        The smallest margin; None before the first run.
    """

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
    margin_min_ns: int | None
    margin_min_tick: int
    margin_last_ns: int
    late_wakes: int
    long_runs: int
    missed_ticks: int
    window: Window
    latency_counts: NDArray[np.int64]
    execution_counts: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class TickFigures:
    """What concerns the tick as a whole.

    Attributes
    ----------
    missed_ticks : int
        Planned starts of the base period that were given up.
    real_time_factor, real_time_factor_total : float
        Simulated over real time while running, in the last complete second and since the reset;
        NaN before.
    """

    missed_ticks: int
    real_time_factor: float
    real_time_factor_total: float


class Statistics:
    """Reads (and resets) a statistics array; the loop fills it.

    Parameters
    ----------
    slices
        Compiled slices first, then the communication slices: the order of the rows.
    base_period_ns
        The base period.
    array
        int64, at least ``words_needed(len(slices), linear_bins)`` long, zeroed or left over from an
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
            raise ValueError(f"the statistics need a flat int64 array of {needed} words")
        array[:needed] = 0
        array[rows.GENERATION] = 1
        array[rows.N_ROWS] = len(slices)
        array[rows.N_LINEAR] = linear_bins
        array[rows.BASE_PERIOD] = base_period_ns
        for index, part in enumerate(slices):
            array[row_offset(index) + rows.PERIOD_TICKS] = part.period_ticks
        rows.publish_magic(array)
        self._adopt(array, [part.name for part in slices])

    def _adopt(self, array: NDArray[np.int64], names: list[str]) -> None:
        self.array = array
        self._offsets = {name: row_offset(index) for index, name in enumerate(names)}

    @classmethod
    def attach(cls, array: NDArray[np.int64], names: Sequence[str] | None = None) -> "Statistics":
        """Read the array of another process; `names` in the order of its rows (None: "0", "1").

        Raises
        ------
        ValueError
            If the array holds no statistics (yet), or other slices.
        """
        if len(array) < rows.N_HEADER or array[rows.MAGIC] != rows.MAGIC_NUMBER:
            raise ValueError("this array holds no scheduler statistics")
        if names is None:
            names = [str(index) for index in range(int(array[rows.N_ROWS]))]
        if len(names) != array[rows.N_ROWS]:
            raise ValueError(f"the statistics hold {array[rows.N_ROWS]} slices, not {len(names)}")
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
        return int(self.array[rows.THREAD_ID])

    def reset(self) -> None:
        """Start counting anew; safe at any time, from any process that maps the array."""
        self.array[rows.GENERATION] += 1

    def slice(self, name: str) -> SliceFigures:
        """Return the figures of one slice."""
        offset = self._offsets[name]
        row = self._read(offset, rows.N_ROW)
        period_ns = int(row[rows.PERIOD_TICKS] * self.array[rows.BASE_PERIOD])
        if row[rows.SEEN_GENERATION] != self.array[rows.GENERATION]:
            rows.clear_row(row, 0)
        return _figures(name, period_ns, row)

    @property
    def tick(self) -> TickFigures:
        """The figures of the tick as a whole."""
        head = self._read(0, rows.N_HEADER)
        if head[rows.SEEN_GENERATION] != head[rows.GENERATION]:
            return TickFigures(0, math.nan, math.nan)
        base = int(head[rows.BASE_PERIOD])
        return TickFigures(
            missed_ticks=int(head[rows.MISSED_TICKS]),
            real_time_factor=_ratio(head[rows.LAST_SPAN_TICKS] * base, head[rows.LAST_SPAN_NS]),
            real_time_factor_total=_ratio(head[rows.RUN_TICKS] * base, head[rows.RUN_NS]),
        )

    @property
    def linear_counts(self) -> NDArray[np.int64]:
        """A copy of the tick's linear histogram of the wake latency, one bin per us."""
        first = row_offset(int(self.array[rows.N_ROWS]))
        whole = self._read(0, first + int(self.array[rows.N_LINEAR]))
        counts = whole[first:]
        if whole[rows.SEEN_GENERATION] != whole[rows.GENERATION]:
            counts[:] = 0
        return counts

    def _read(self, offset: int, length: int) -> NDArray[np.int64]:
        out = np.empty(length, dtype=np.int64)
        for _ in range(_READ_ROUNDS):
            if rows.read_row(self.array, offset, out):
                return out
            time.sleep(_READ_PAUSE_S)  # the writer was preempted, or its core stolen, while writing
        raise RuntimeError("the statistics stay half written: their writer was stopped or has died")


def map_statistics(path: Path, n_words: int | None = None) -> NDArray[np.int64]:
    """Map a file of int64 words shared by processes.

    Parameters
    ----------
    path
        On a memory file system (/dev/shm): elsewhere writing back to disk would stop the loop.
    n_words
        Make the file new with so many words; None: map what is there.
    """
    if n_words is not None:
        path.touch(mode=0o600)
        os.truncate(path, 8 * n_words)
    with path.open("r+b") as file:
        return np.frombuffer(mmap.mmap(file.fileno(), 0), dtype=np.int64)


def row_offset(index: int) -> int:
    """Return where the row of slice number `index` begins."""
    return rows.N_HEADER + index * rows.N_ROW


def _ratio(part: int, whole: int) -> float:
    return float(part / whole) if whole else math.nan


def _figures(name: str, period_ns: int, row: NDArray[np.int64]) -> SliceFigures:
    lowest_margin = int(row[rows.MARGIN_MIN])
    return SliceFigures(
        name=name,
        period_ns=period_ns,
        count=int(row[rows.COUNT]),
        latency_sum_ns=int(row[rows.LATENCY_SUM]),
        latency_max_ns=int(row[rows.LATENCY_MAX]),
        latency_max_tick=int(row[rows.LATENCY_MAX_TICK]),
        latency_last_ns=int(row[rows.LATENCY_LAST]),
        execution_sum_ns=int(row[rows.EXECUTION_SUM]),
        execution_max_ns=int(row[rows.EXECUTION_MAX]),
        execution_max_tick=int(row[rows.EXECUTION_MAX_TICK]),
        execution_last_ns=int(row[rows.EXECUTION_LAST]),
        margin_min_ns=None if lowest_margin == rows.NEVER else lowest_margin,
        margin_min_tick=int(row[rows.MARGIN_MIN_TICK]),
        margin_last_ns=int(row[rows.MARGIN_LAST]),
        late_wakes=int(row[rows.N_LATE_WAKE]),
        long_runs=int(row[rows.N_LONG_RUN]),
        missed_ticks=int(row[rows.N_MISSED]),
        window=_window(row[rows.LAST_WINDOW : rows.LATENCY_COUNTS]),
        latency_counts=row[rows.LATENCY_COUNTS : rows.EXECUTION_COUNTS].copy(),
        execution_counts=row[rows.EXECUTION_COUNTS :].copy(),
    )


def _window(window: NDArray[np.int64]) -> Window:
    count = int(window[rows.W_COUNT])
    if count == 0:
        return Window(0, math.nan, math.nan, math.nan, math.nan)
    total, squares = int(window[rows.W_SUM]), int(window[rows.W_SQUARES])
    variance = (count * squares - total * total) / count**2
    return Window(
        count=count,
        mean_ns=total / count,
        deviation_ns=math.sqrt(variance),
        low_ns=float(window[rows.W_MIN]),
        high_ns=float(window[rows.W_MAX]),
    )
