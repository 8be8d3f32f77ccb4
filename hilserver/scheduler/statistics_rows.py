"""Statistics as int64 words: the layout, and the kernels that fill and read it.

One array holds everything; in shared memory, another process can read it without asking. A header
is followed by one row per slice and, optionally, by a linear histogram of the wake latency of the
tick in bins of 1 us (the last bin counts all longer ones).

Each row has exactly one writer, which never waits for a reader: a row's sequence number is odd
while it is written, and the reader tries again. ``reset`` only raises a generation number in the
header; each writer clears its own row when it sees the new number, so no row is ever half reset.
"""

from typing import Annotated

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from hilserver.compiled import inlined, kernel
from hilserver.compiled.atomics import fence, load_acquire, store_release
from hilserver.compiled.histogram import N_BUCKETS, bucket_index
from hilserver.compiled.records import Record, assign, record_at
from hilserver.scheduler.law import LATE_WAKE, LONG_RUN

MAGIC_NUMBER = 0x68696C_73746174  # "hilstat"
WINDOW_RUNS = 1000
WINDOW_NS = 1_000_000_000
SQUARE_LIMIT_NS = 90_000_000
"""Latencies are limited to this in the sum of squares, so that 1000 squares fit into int64."""
NEVER = np.iinfo(np.int64).max

Counts = Annotated[NDArray[np.int64], N_BUCKETS]


class TickHead(Record):
    """Figures of the tick as a whole; like every row it begins with a sequence number."""

    sequence: int
    seen_generation: int
    magic: int
    generation: int
    n_rows: int
    n_linear: int
    base_period: int  # [ns]
    thread_id: int
    missed_ticks: int  # cleared by a reset, like all below
    run_ticks: int
    run_ns: int
    span_ticks: int  # this second
    span_ns: int
    last_span_ticks: int  # the last complete one
    last_span_ns: int
    free: int


class Window(Record):
    """At most 1000 runs or 1 s."""

    count: int
    total: int  # [ns]
    squares: int  # [ns2]
    low: int  # [ns]
    high: int  # [ns]
    start: int  # [ns]


class SliceRow(Record):
    """One slice; times in ns."""

    sequence: int
    seen_generation: int
    count: int  # cleared by a reset, like all below except the period
    period_ticks: int
    latency_sum_ns: int
    latency_max_ns: int
    latency_max_tick: int
    execution_sum_ns: int
    execution_max_ns: int
    execution_max_tick: int
    margin_min_ns: int
    margin_min_tick: int
    late_wakes: int
    long_runs: int
    missed_ticks: int
    missed_carry: int
    latency_last_ns: int
    execution_last_ns: int
    margin_last_ns: int
    last_tick: int
    window: Window
    last_window: Window  # the last complete one, which is reported
    latency_counts: Counts
    execution_counts: Counts


HEAD, ROW = TickHead.layout, SliceRow.layout
N_HEAD, N_ROW = TickHead.n_words, SliceRow.n_words
MAGIC, GENERATION = TickHead.where("magic").start, TickHead.where("generation").start
CLEARED, COUNT = TickHead.where("missed_ticks").start, SliceRow.where("count").start

_WORDS = types.int64[::1]
_READ_ONLY_WORDS = types.Array(types.int64, 1, "C", readonly=True)


@inlined
def begin_write(stats: NDArray[np.int64], row: int) -> None:
    """Make the sequence number of the row at offset `row` odd."""
    store_release(stats, row, stats[row] + 1)
    fence()


@inlined
def end_write(stats: NDArray[np.int64], row: int) -> None:
    """Make the sequence number even again."""
    store_release(stats, row, stats[row] + 1)


@kernel(
    [types.boolean(words, types.int64, _WORDS) for words in (_WORDS, _READ_ONLY_WORDS)]
)
def read_row(stats: NDArray[np.int64], row: int, out: NDArray[np.int64]) -> bool:
    """Copy a row to `out`; False if all 64 attempts met its writer."""
    for _ in range(64):
        before = load_acquire(stats, row)
        if before % 2 == 0:
            for index in range(out.shape[0]):
                out[index] = stats[row + index]
            fence()
            if load_acquire(stats, row) == before:
                return True
    return False


@kernel(types.void(_WORDS))
def publish_magic(stats: NDArray[np.int64]) -> None:
    """Mark the layout as complete, with everything written before already visible."""
    store_release(stats, MAGIC, MAGIC_NUMBER)


@kernel(types.void(_WORDS, types.int64))
def clear_row(stats: NDArray[np.int64], row: int) -> None:
    """Clear the counts of a slice's row; its period stays."""
    slice_row = record_at(stats, row, ROW)
    period_ticks = slice_row.period_ticks
    for index in range(COUNT, N_ROW):
        stats[row + index] = 0
    slice_row.period_ticks = period_ticks
    slice_row.margin_min_ns = slice_row.window.low = NEVER


@inlined
def clear_header(stats: NDArray[np.int64]) -> None:
    """Clear missed ticks, the real-time factor and the linear histogram."""
    for index in range(CLEARED, N_HEAD):
        stats[index] = 0
    head = record_at(stats, 0, HEAD)
    first = N_HEAD + head.n_rows * N_ROW
    for index in range(first, first + head.n_linear):
        stats[index] = 0


@inlined
def record_tick(
    stats: NDArray[np.int64], latency_ns: int, since_last_ns: int, missed: int
) -> None:
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
    head = record_at(stats, 0, HEAD)
    if head.seen_generation != generation:
        clear_header(stats)
        head.seen_generation = generation
    head.missed_ticks += missed
    if since_last_ns > 0:
        head.run_ticks += 1
        head.run_ns += since_last_ns
        head.span_ticks += 1
        head.span_ns += since_last_ns
        if head.span_ns >= WINDOW_NS:
            head.last_span_ticks, head.last_span_ns = head.span_ticks, head.span_ns
            head.span_ticks = head.span_ns = 0
    if head.n_linear > 0:
        first = N_HEAD + head.n_rows * N_ROW
        stats[first + min(max(latency_ns, 0) // 1000, head.n_linear - 1)] += 1
    end_write(stats, 0)


@inlined
def record_window(window: Window, last: Window, latency_ns: int, now_ns: int) -> None:
    """Add a latency to a window; a full window becomes the last one."""
    clipped = min(latency_ns, SQUARE_LIMIT_NS)
    if window.count == 0:
        window.start = now_ns
    window.count += 1
    window.total += clipped
    window.squares += clipped * clipped
    window.low = min(window.low, latency_ns)
    window.high = max(window.high, latency_ns)
    if window.count >= WINDOW_RUNS or now_ns - window.start >= WINDOW_NS:
        assign(last, window)
        window.count = window.total = window.squares = window.high = window.start = 0
        window.low = NEVER


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
    r = record_at(stats, row, ROW)
    if r.seen_generation != generation:
        clear_row(stats, row)
        r.seen_generation = generation
    r.count += 1
    r.latency_sum_ns += latency_ns
    r.execution_sum_ns += execution_ns
    if latency_ns > r.latency_max_ns or r.count == 1:
        r.latency_max_ns, r.latency_max_tick = latency_ns, tick
    if execution_ns > r.execution_max_ns or r.count == 1:
        r.execution_max_ns, r.execution_max_tick = execution_ns, tick
    if margin_ns < r.margin_min_ns:
        r.margin_min_ns, r.margin_min_tick = margin_ns, tick
    r.late_wakes += kind == LATE_WAKE
    r.long_runs += kind == LONG_RUN
    r.missed_ticks += missed
    r.latency_last_ns, r.execution_last_ns = latency_ns, execution_ns
    r.margin_last_ns, r.last_tick = margin_ns, tick
    r.latency_counts[bucket_index(latency_ns)] += 1
    r.execution_counts[bucket_index(execution_ns)] += 1
    record_window(r.window, r.last_window, latency_ns, start_ns)
    end_write(stats, row)


def words_needed(n_slices: int, linear_bins: int = 0) -> int:
    """Return the length of the statistics array for this number of slices and 1 us bins."""
    return N_HEAD + n_slices * N_ROW + linear_bins
