"""Statistics: figures from known runs, reset without tearing, reading from elsewhere."""

import math
import threading

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.compiled.histogram import BOUNDS_NS
from hilserver.scheduler import Slice, Statistics, map_statistics, words_needed
from hilserver.scheduler import statistics_rows as rows
from hilserver.scheduler.law import LATE_WAKE, LONG_RUN, NO_OVERRUN
from hilserver.scheduler.statistics import row_offset
from tests.scheduler.kernels import counting_step
from tests.scheduler.rig import running, until

ONE = [Slice("plant", 1, True)]


def record(
    statistics, tick, latency, execution, kind=NO_OVERRUN, missed=0, margin=None
):
    margin = 1_000_000 - latency - execution if margin is None else margin
    start = tick * 1_000_000 + latency
    rows.record_run(
        statistics.array,
        row_offset(0),
        tick,
        start,
        latency,
        execution,
        margin,
        kind,
        missed,
    )


runs = st.lists(
    st.tuples(st.integers(0, 80_000_000), st.integers(0, 20_000_000)),
    min_size=1,
    max_size=80,
)


@given(history=runs)
def test_sums_extremes_and_histograms_agree_with_the_samples(history):
    statistics = Statistics(ONE, 1_000_000)
    for tick, (latency, execution) in enumerate(history):
        record(statistics, tick, latency, execution)
    figures = statistics.slice("plant")
    latency, execution = np.array(history).T
    assert figures.count == len(history)
    assert figures.latency_sum_ns == latency.sum()
    assert figures.latency_max_ns == latency.max()
    assert figures.latency_max_tick == latency.argmax()
    assert figures.execution_sum_ns == execution.sum()
    assert figures.execution_max_tick == execution.argmax()
    assert figures.margin_min_ns == (1_000_000 - latency - execution).min()
    expected = np.bincount(
        np.searchsorted(BOUNDS_NS, latency), minlength=len(BOUNDS_NS) + 1
    )
    assert np.array_equal(figures.latency_counts, expected)
    assert figures.execution_counts.sum() == len(history)


@settings(max_examples=20)
@given(seed=st.integers(0, 2**32), high=st.integers(1, 80_000_000))
def test_jitter_is_that_of_the_last_complete_window(seed, high):
    latencies = np.random.default_rng(seed).integers(0, high, 1000).tolist()
    statistics = Statistics(ONE, 1_000_000)
    for i, latency in enumerate(latencies):
        start = i * 10  # all within a second: the window closes by count
        rows.record_run(statistics.array, row_offset(0), i, start, latency, 1, 0, 0, 0)
    window = statistics.slice("plant").window
    assert window.count == 1000
    assert window.mean_ns == pytest.approx(np.mean(latencies))
    assert window.deviation_ns == pytest.approx(np.std(latencies), rel=1e-6, abs=1.0)
    assert (window.low_ns, window.high_ns) == (min(latencies), max(latencies))


def test_window_closes_after_a_second_and_bears_absurd_latencies():
    statistics = Statistics(ONE, 1_000_000)
    assert math.isnan(statistics.slice("plant").window.deviation_ns)
    for i in range(5):
        start = i * 300_000_000
        rows.record_run(statistics.array, row_offset(0), i, start, 10**13, 1, 0, 0, 0)
    window = statistics.slice("plant").window
    assert window.count == 5
    assert window.deviation_ns == 0.0  # all beyond 90 ms count as 90 ms
    assert window.high_ns == 1e13


def test_overruns_by_kind_missed_ticks_and_the_first_margin():
    statistics = Statistics(ONE, 1_000_000)
    assert statistics.slice("plant").margin_min_ns is None
    record(statistics, 0, 5, 5)
    record(statistics, 1, 5, 5, LATE_WAKE, missed=3)
    record(statistics, 2, 5, 5, LONG_RUN)
    figures = statistics.slice("plant")
    assert (figures.late_wakes, figures.long_runs, figures.missed_ticks) == (1, 1, 3)


def test_real_time_factor_and_linear_bins():
    statistics = Statistics(ONE, 1_000_000, linear_bins=50)
    for i in range(1500):
        rows.record_tick(
            statistics.array, 7_999 if i % 2 else 90_000, 2_000_000 if i else 0, 0
        )
    assert statistics.tick.real_time_factor == 0.5
    assert statistics.tick.real_time_factor_total == 0.5
    counts = statistics.linear_counts
    assert (counts[7], counts[49], counts.sum()) == (750, 750, 1500)


def test_reset_forgets_everything_at_the_next_run():
    statistics = Statistics(ONE, 1_000_000, linear_bins=50)
    record(statistics, 0, 5_000_000, 5, LATE_WAKE, 2)
    rows.record_tick(statistics.array, 7_000, 1_000_000, 2)
    statistics.reset()
    # seen at once, although no run came yet
    assert statistics.slice("plant").count == 0
    assert statistics.slice("plant").margin_min_ns is None
    assert statistics.linear_counts.sum() == 0
    assert statistics.tick.missed_ticks == 0
    record(statistics, 1, 5, 5)
    figures = statistics.slice("plant")
    assert (figures.count, figures.latency_max_ns, figures.latency_sum_ns) == (1, 5, 5)
    assert (figures.late_wakes, figures.missed_ticks) == (0, 0)
    assert figures.latency_counts.sum() == 1


def test_a_reader_never_sees_half_a_run():
    statistics = Statistics(ONE, 1_000_000)
    record(statistics, 0, 1000, 1000)
    stop = threading.Event()

    def write():
        tick = 0
        while not stop.is_set():
            tick += 1
            record(statistics, tick, 1000, 1000)

    writer = threading.Thread(target=write)
    writer.start()
    try:
        for round_ in range(3000):
            figures = statistics.slice("plant")
            assert figures.latency_sum_ns == 1000 * figures.count
            assert figures.latency_counts.sum() == figures.count
            if round_ % 100 == 0:
                statistics.reset()
    finally:
        stop.set()
        writer.join()


async def test_reset_while_the_loop_runs_tears_nothing():
    async with running(counting_step, warm_up_ticks=0, linear_bins=100) as rig:
        statistics = rig.scheduler.statistics
        for _ in range(30):
            figures = statistics.slice("plant")
            assert (
                figures.latency_counts.sum()
                == figures.execution_counts.sum()
                == figures.count
            )
            tick = rig.scheduler.tick
            rig.scheduler.statistics.reset()
            count = statistics.slice("plant").count
            assert count <= rig.scheduler.tick - tick + 1, (
                "runs from before are counted"
            )
            await until(lambda: statistics.slice("plant").count >= 3)
            assert statistics.linear_counts.sum() < 2000


def test_another_process_can_map_read_and_reset(tmp_path):
    path = tmp_path / "statistics"
    array = map_statistics(path, words_needed(1, 10))
    with pytest.raises(ValueError, match="holds no scheduler statistics"):
        Statistics.attach(map_statistics(path))
    mine = Statistics(ONE, 1_000_000, array, linear_bins=10)
    theirs = Statistics.attach(map_statistics(path), ["plant"])
    record(mine, 0, 5, 5)
    assert theirs.slice("plant").count == 1
    theirs.reset()
    assert mine.slice("plant").count == 0
    read_only = map_statistics(path).view()
    read_only.flags.writeable = False
    assert Statistics.attach(read_only).names == ["0"]
    with pytest.raises(ValueError, match="hold 1 slices, not 2"):
        Statistics.attach(array, ["a", "b"])


def test_arrays_that_do_not_fit_are_refused():
    with pytest.raises(ValueError, match="flat int64 array"):
        Statistics(ONE, 1000, np.zeros(3, dtype=np.int64))


def test_a_dead_writer_is_named(monkeypatch):
    monkeypatch.setattr("hilserver.scheduler.statistics._READ_ROUNDS", 3)
    statistics = Statistics(ONE, 1000)
    statistics.array[row_offset(0)] += 1
    with pytest.raises(RuntimeError, match="writer was stopped or has died"):
        statistics.slice("plant")
