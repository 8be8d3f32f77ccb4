"""Statistics as int64 words: the layout, and the kernels that fill and read it.

One array holds everything, and it may lie in shared memory, so that another process reads it
without asking. A header is followed by one row per slice and, optionally, by a linear histogram of
the wake latency of the tick in bins of 1 us (the last bin takes what is longer).

Each row has exactly one writer. A reader never makes it wait: a row's sequence number is odd while
it is written, and the reader tries again. ``reset`` only raises a generation number in the header;
each writer clears its own row when it sees the new number, so a reset tears nothing.
"""

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from hilserver.compiled import kernel
from hilserver.compiled.atomics import fence, load_acquire, store_release
from hilserver.compiled.histogram import N_BUCKETS, bucket_index
from hilserver.scheduler.law import LATE_WAKE, LONG_RUN

# Every row, also the header, begins with these two.
SEQUENCE, SEEN_GENERATION = 0, 1
# Header
MAGIC, GENERATION, N_ROWS, N_LINEAR, BASE_PERIOD, THREAD_ID = range(2, 8)
MISSED_TICKS = 8
RUN_TICKS, RUN_NS = 9, 10
SPAN_TICKS, SPAN_NS, LAST_SPAN_TICKS, LAST_SPAN_NS = range(11, 15)
N_HEADER = 16
MAGIC_NUMBER = 0x68696C_73746174  # "hilstat"

# Row
COUNT, PERIOD_TICKS = 2, 3
LATENCY_SUM, LATENCY_MAX, LATENCY_MAX_TICK = 4, 5, 6
EXECUTION_SUM, EXECUTION_MAX, EXECUTION_MAX_TICK = 7, 8, 9
MARGIN_MIN, MARGIN_MIN_TICK = 10, 11
N_LATE_WAKE, N_LONG_RUN, N_MISSED, MISSED_CARRY = range(12, 16)
LATENCY_LAST, EXECUTION_LAST, MARGIN_LAST, TICK_LAST = range(16, 20)
# A window of at most 1000 runs or 1 s; the last complete one is what is reported.
WINDOW = 20
LAST_WINDOW = 26
W_COUNT, W_SUM, W_SQUARES, W_MIN, W_MAX, W_START = range(6)
LATENCY_COUNTS = 32
EXECUTION_COUNTS = LATENCY_COUNTS + N_BUCKETS
N_ROW = EXECUTION_COUNTS + N_BUCKETS

WINDOW_RUNS = 1000
WINDOW_NS = 1_000_000_000
SQUARE_LIMIT_NS = 90_000_000
"""Latencies enter the sum of squares at most with this, so that 1000 squares fit into int64."""
NEVER = np.iinfo(np.int64).max

_WORDS = types.int64[::1]
_READ_ONLY_WORDS = types.Array(types.int64, 1, "C", readonly=True)


@kernel()
def begin_write(stats: NDArray[np.int64], row: int) -> None:
    """Make the sequence number of the row at offset `row` odd."""
    store_release(stats, row + SEQUENCE, stats[row + SEQUENCE] + 1)
    fence()


@kernel()
def end_write(stats: NDArray[np.int64], row: int) -> None:
    """Make the sequence number even again."""
    store_release(stats, row + SEQUENCE, stats[row + SEQUENCE] + 1)


@kernel([types.boolean(words, types.int64, _WORDS) for words in (_WORDS, _READ_ONLY_WORDS)])
def read_row(stats: NDArray[np.int64], row: int, out: NDArray[np.int64]) -> bool:
    """Copy a row to `out`; False if its writer was always in the way (64 attempts)."""
    for _ in range(64):
        before = load_acquire(stats, row + SEQUENCE)
        if before % 2 == 0:
            for index in range(out.shape[0]):
                out[index] = stats[row + index]
            fence()
            if load_acquire(stats, row + SEQUENCE) == before:
                return True
    return False


@kernel(types.void(_WORDS))
def publish_magic(stats: NDArray[np.int64]) -> None:
    """Mark a complete layout as such; what was written before is seen before."""
    store_release(stats, MAGIC, MAGIC_NUMBER)


@kernel(types.void(_WORDS, types.int64))
def clear_row(stats: NDArray[np.int64], row: int) -> None:
    """Forget what a slice's row has counted; its period stays."""
    for index in range(COUNT, N_ROW):
        if index != PERIOD_TICKS:
            stats[row + index] = 0
    stats[row + MARGIN_MIN] = NEVER
    stats[row + WINDOW + W_MIN] = NEVER


@kernel()
def clear_header(stats: NDArray[np.int64]) -> None:
    """Forget missed ticks, the real-time factor and the linear histogram."""
    for index in range(MISSED_TICKS, N_HEADER):
        stats[index] = 0
    first = N_HEADER + stats[N_ROWS] * N_ROW
    for index in range(first, first + stats[N_LINEAR]):
        stats[index] = 0


@kernel()
def record_tick(stats: NDArray[np.int64], latency_ns: int, since_last_ns: int, missed: int) -> None:
    """Count one tick in the header.

    Parameters
    ----------
    stats
        The whole array.
    latency_ns
        Wake latency of the tick [ns].
    since_last_ns
        Time since the previous tick's start [ns]; 0 if there is none (first, after a pause).
    missed
        Planned starts that were given up before it.
    """
    generation = load_acquire(stats, GENERATION)
    begin_write(stats, 0)
    if stats[SEEN_GENERATION] != generation:
        clear_header(stats)
        stats[SEEN_GENERATION] = generation
    stats[MISSED_TICKS] += missed
    if since_last_ns > 0:
        stats[RUN_TICKS] += 1
        stats[RUN_NS] += since_last_ns
        stats[SPAN_TICKS] += 1
        stats[SPAN_NS] += since_last_ns
        if stats[SPAN_NS] >= WINDOW_NS:
            stats[LAST_SPAN_TICKS] = stats[SPAN_TICKS]
            stats[LAST_SPAN_NS] = stats[SPAN_NS]
            stats[SPAN_TICKS] = 0
            stats[SPAN_NS] = 0
    if stats[N_LINEAR] > 0:
        first = N_HEADER + stats[N_ROWS] * N_ROW
        stats[first + min(max(latency_ns, 0) // 1000, stats[N_LINEAR] - 1)] += 1
    end_write(stats, 0)


@kernel()
def record_window(stats: NDArray[np.int64], window: int, latency_ns: int, now_ns: int) -> None:
    """Add a latency to the window at offset `window`; close the window when it is full."""
    clipped = min(latency_ns, SQUARE_LIMIT_NS)
    if stats[window + W_COUNT] == 0:
        stats[window + W_START] = now_ns
    stats[window + W_COUNT] += 1
    stats[window + W_SUM] += clipped
    stats[window + W_SQUARES] += clipped * clipped
    stats[window + W_MIN] = min(stats[window + W_MIN], latency_ns)
    stats[window + W_MAX] = max(stats[window + W_MAX], latency_ns)
    full = stats[window + W_COUNT] >= WINDOW_RUNS
    if full or now_ns - stats[window + W_START] >= WINDOW_NS:
        for index in range(LAST_WINDOW - WINDOW):
            stats[window + LAST_WINDOW - WINDOW + index] = stats[window + index]
            stats[window + index] = 0
        stats[window + W_MIN] = NEVER


@kernel(types.void(_WORDS, *(types.int64,) * 8))
def record_run(
    stats: NDArray[np.int64],
    row: int,
    tick: int,
    start_ns: int,
    latency_ns: int,
    execution_ns: int,
    margin_ns: int,
    kind: int,
    missed: int,
) -> None:
    """Count one run of a slice.

    Parameters
    ----------
    stats, row
        The whole array and the offset of the slice's row.
    tick, start_ns
        Which tick, and when the slice began [ns].
    latency_ns, execution_ns, margin_ns
        Start minus planned start; work; deadline minus end [ns].
    kind
        ``NO_OVERRUN``, ``LATE_WAKE`` or ``LONG_RUN``.
    missed
        Planned starts of this slice that were given up before this run.
    """
    generation = load_acquire(stats, GENERATION)
    begin_write(stats, row)
    if stats[row + SEEN_GENERATION] != generation:
        clear_row(stats, row)
        stats[row + SEEN_GENERATION] = generation
    stats[row + COUNT] += 1
    stats[row + LATENCY_SUM] += latency_ns
    stats[row + EXECUTION_SUM] += execution_ns
    if latency_ns > stats[row + LATENCY_MAX] or stats[row + COUNT] == 1:
        stats[row + LATENCY_MAX] = latency_ns
        stats[row + LATENCY_MAX_TICK] = tick
    if execution_ns > stats[row + EXECUTION_MAX] or stats[row + COUNT] == 1:
        stats[row + EXECUTION_MAX] = execution_ns
        stats[row + EXECUTION_MAX_TICK] = tick
    if margin_ns < stats[row + MARGIN_MIN]:
        stats[row + MARGIN_MIN] = margin_ns
        stats[row + MARGIN_MIN_TICK] = tick
    stats[row + N_LATE_WAKE] += kind == LATE_WAKE
    stats[row + N_LONG_RUN] += kind == LONG_RUN
    stats[row + N_MISSED] += missed
    stats[row + LATENCY_LAST] = latency_ns
    stats[row + EXECUTION_LAST] = execution_ns
    stats[row + MARGIN_LAST] = margin_ns
    stats[row + TICK_LAST] = tick
    stats[row + LATENCY_COUNTS + bucket_index(latency_ns)] += 1
    stats[row + EXECUTION_COUNTS + bucket_index(execution_ns)] += 1
    record_window(stats, row + WINDOW, latency_ns, start_ns)
    end_write(stats, row)


def words_needed(n_slices: int, linear_bins: int = 0) -> int:
    """Return the length of the statistics array for so many slices and 1 us bins."""
    return N_HEADER + n_slices * N_ROW + linear_bins
