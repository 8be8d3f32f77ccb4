"""Overruns are counted as what they are, explained, and end where the limits say."""

import asyncio
import gc
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from hilserver.scheduler import OverrunLimits, OverrunPolicy, Slice, StopReason
from hilserver.scheduler.causes import CauseFinder, OverrunCause, OverrunEvidence, judge
from hilserver.scheduler.exchange import (
    RECORDS_LOST,
    Exchange,
    OverrunRecord,
    next_record,
)
from hilserver.scheduler.gc_pauses import GcPauses
from hilserver.scheduler.law import LATE_WAKE, LONG_RUN
from hilserver.scheduler.overruns import OverrunReport
from tests.scheduler.kernels import BUSY_NS, BUSY_TICK, FAULTS, LAST_FAULT, busy_step
from tests.scheduler.rig import running, until

LONG_NS = 60_000_000
SLICES = (
    Slice("plant", 1, True),
    Slice("sensors", 10, True),
    Slice("publish", 20, False),
)


def long_sensors(rig):
    rig.words[BUSY_TICK], rig.words[BUSY_NS] = 150, LONG_NS


async def run_long(backend="thread", **options):
    """Let the sensors slice run 60 ms in tick 150; return the rig after its report."""
    async with running(
        busy_step, backend=backend, slices=SLICES, prepare=long_sensors, **options
    ) as rig:
        await until(
            lambda: any(r.tick == 150 for r in rig.reports) and rig.scheduler.tick > 200
        )
    (report,) = (r for r in rig.reports if r.tick == 150)
    return rig, report


@pytest.mark.parametrize("backend", ["thread", "timerfd"])
async def test_a_slice_that_runs_long_is_named(backend):
    rig, report = await run_long(backend)
    assert (report.slice, report.kind, report.cause) == (
        "sensors",
        "long_run",
        OverrunCause.SLICE,
    )
    assert report.execution_ns >= LONG_NS
    figures = rig.scheduler.statistics.slice("sensors")
    assert figures.long_runs >= 1
    assert figures.execution_max_tick == 150
    assert figures.margin_min_ns <= -LONG_NS + 1_000_000
    assert figures.margin_min_tick == 150
    assert str(report).startswith("sensors ran ")
    assert "in tick 150: slice" in str(report)


async def test_a_tick_that_does_not_end_is_told_while_it_lasts():
    def endless(rig):
        rig.words[BUSY_TICK], rig.words[BUSY_NS] = 150, 1_600_000_000

    async with running(busy_step, slices=SLICES, prepare=endless) as rig:
        await until(lambda: any(r.consequence == "stalled" for r in rig.reports))
        assert rig.scheduler.tick == 150, "it still lasts"
        await until(lambda: rig.scheduler.tick > 151)
    (report,) = (r for r in rig.reports if r.consequence == "stalled")
    assert report.tick == 150
    assert report.execution_ns > 1_000_000_000
    assert str(report).endswith("in tick 150: slice, stalled")


async def test_a_long_period_is_no_stall():
    slices = (Slice("plant", 1, True), Slice("sensors", 10, True))
    async with running(
        busy_step, slices=slices, base_period_ns=1_500_000_000, warm_up_ticks=0
    ) as rig:
        await asyncio.sleep(1.4)
        assert time.monotonic_ns() - rig.scheduler.heartbeat_ns < 200_000_000
    assert rig.reports == []


async def test_catch_up_misses_nothing_within_its_limit_and_skip_misses_the_rest():
    rig, _ = await run_long(policy=OverrunPolicy("catch_up", 10**6))
    assert rig.scheduler.statistics.tick.missed_ticks == 0
    rig, _ = await run_long(policy=OverrunPolicy("skip"))
    assert rig.scheduler.statistics.tick.missed_ticks >= 58
    assert rig.scheduler.statistics.slice("plant").missed_ticks >= 58
    assert rig.scheduler.statistics.slice("sensors").missed_ticks >= 5
    rig, _ = await run_long(policy=OverrunPolicy("stretch"))
    assert rig.scheduler.statistics.tick.missed_ticks == 0


async def test_limits_end_in_the_safe_state():
    rig, report = await run_long(limits=OverrunLimits(single_ns=50_000_000))
    assert rig.words[FAULTS] >= 1
    assert rig.words[LAST_FAULT] == 1
    assert report.consequence == "single_overrun_limit"
    rig, report = await run_long(limits=OverrunLimits(consecutive=1))
    assert rig.words[FAULTS] >= 1
    assert rig.words[LAST_FAULT] == 2
    assert report.consequence == "consecutive_overrun_limit"


@pytest.mark.parametrize("backend", ["thread", "timerfd"])
async def test_policy_fail_ends_the_run(backend):
    async with running(
        busy_step,
        backend=backend,
        slices=SLICES,
        prepare=long_sensors,
        policy=OverrunPolicy("fail"),
        # A busy machine may be late before; the long run is the first judged.
        warm_up_ticks=150,
    ) as rig:
        async with asyncio.timeout(120):
            assert await rig.scheduler.finished is StopReason.OVERRUN
        assert rig.scheduler.tick == 151
    assert rig.reports[-1].consequence == "stopped"


STOPPED_PROCESS = """
import asyncio, sys
from tests.scheduler.kernels import counting_step
from tests.scheduler.rig import running, until

async def main():
    async with running(counting_step, backend=sys.argv[1], warm_up_ticks=20) as rig:
        await until(lambda: rig.scheduler.tick > 100)
        print("running", flush=True)
        stopped = lambda r: r.slice == "plant" and r.cause == "stopped"
        await until(lambda: any(map(stopped, rig.reports)), 20)
        report = next(filter(stopped, rig.reports))
        print(report.slice, report.kind, report.cause, report.latency_ns)
        print(rig.scheduler.statistics.slice("plant").late_wakes, flush=True)

asyncio.run(main())
"""


@pytest.mark.parametrize("backend", ["thread", "timerfd"])
async def test_a_process_that_was_stopped_woke_late(backend):
    root = Path(__file__).parents[2]
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-c", STOPPED_PROCESS, backend, stdout=subprocess.PIPE, cwd=root
    )
    try:
        async with asyncio.timeout(120):
            assert await process.stdout.readline() == b"running\n"
            process.send_signal(signal.SIGSTOP)
            await asyncio.sleep(0.05)
            process.send_signal(signal.SIGCONT)
            slice_name, kind, cause, latency_ns = (
                await process.stdout.readline()
            ).split()
            late_wakes = int(await process.stdout.readline())
            assert await process.wait() == 0
    finally:
        if process.returncode is None:
            process.kill()
            await process.wait()
    assert (slice_name, kind, cause) == (b"plant", b"late_wake", b"stopped")
    assert int(latency_ns) > 25_000_000
    assert late_wakes >= 1


def evidence(**known):
    quiet = {
        "span_ns": 10_000_000,
        "period_ns": 1_000_000,
        "late": True,
        "cpu_ns": 0,
        "minor_faults": 0,
        "major_faults": 0,
        "preempted": 0,
        "run_delay_ns": 0,
        "steal_ns": 0,
        "gc_ns": 0,
        "stopped": False,
    }
    return OverrunEvidence(**(quiet | known))


@pytest.mark.parametrize(
    ("known", "cause"),
    [
        ({}, OverrunCause.UNKNOWN),
        ({"stopped": True, "steal_ns": 10**9}, OverrunCause.STOPPED),
        ({"gc_ns": 6_000_000}, OverrunCause.GC),
        ({"gc_ns": 4_000_000}, OverrunCause.UNKNOWN),
        ({"steal_ns": 10_000_000}, OverrunCause.STOLEN),
        ({"run_delay_ns": 9_000_000}, OverrunCause.PREEMPTED),
        ({"major_faults": 1}, OverrunCause.FAULT),
        (
            {"cpu_ns": 10_000_000},
            OverrunCause.UNKNOWN,
        ),  # a late wake is not the slice's doing
        ({"late": False, "cpu_ns": 9_000_000, "preempted": 3}, OverrunCause.SLICE),
        (
            {"late": False, "cpu_ns": 1_500_000, "run_delay_ns": 8_000_000},
            OverrunCause.SLICE,
        ),
        (
            {"late": False, "cpu_ns": 900_000, "run_delay_ns": 8_000_000},
            OverrunCause.PREEMPTED,
        ),
        ({"late": False, "preempted": 3}, OverrunCause.PREEMPTED),
        ({"late": False, "minor_faults": 3}, OverrunCause.FAULT),
    ],
)
def test_causes_by_evidence(known, cause):
    assert judge(evidence(**known)) is cause


def test_finder_reads_proc(tmp_path):
    (tmp_path / "self/task/7").mkdir(parents=True)
    schedstat, stat = tmp_path / "self/task/7/schedstat", tmp_path / "stat"
    schedstat.write_text("100 0 1\n")
    stat.write_text("cpu  1 0 0 0 0 0 0 50 0 0\ncpu0 1\n")
    now = [10**9]
    finder = CauseFinder(
        7,
        GcPauses(),
        period_ns=10**6,
        gc_stops_ticks=True,
        clock_ns=lambda: now[0],
        proc=tmp_path,
    )
    late = OverrunRecord(5, LATE_WAKE, 0, 10**9, 8_000_000, 1000, 1000, 0, 0, 0, 8, 0)
    assert finder.explain(late, finder.look()) is OverrunCause.UNKNOWN
    schedstat.write_text("100 7000000 1\n")
    assert finder.explain(late, finder.look()) is OverrunCause.PREEMPTED
    stat.write_text("cpu  1 0 0 0 0 0 0 51 0 0\n")
    assert finder.explain(late, finder.look()) is OverrunCause.STOLEN
    now[0] += 2 * 10**9
    finder.look_around()  # from here on the old figures explain nothing
    assert finder.explain(late, finder.look()) is OverrunCause.UNKNOWN
    now[0] = 10**9 + 9_000_000
    finder.continued()
    assert finder.explain(late, finder.look()) is OverrunCause.STOPPED
    schedstat.unlink()
    stat.unlink()
    blind = CauseFinder(
        7, GcPauses(), period_ns=10**6, gc_stops_ticks=True, proc=tmp_path
    )
    long = OverrunRecord(5, LONG_RUN, 0, 0, 0, 2_000_000, 2_000_000, 0, 0, 0, 0, 0)
    assert blind.explain(long, blind.look()) is OverrunCause.SLICE


def test_gc_pauses_are_measured():
    pauses = GcPauses()
    pauses.start(freeze=False)
    try:
        gc.collect()
        assert pauses.pauses.count >= 1
        assert pauses.overlap_ns(0, 10**18) == pauses.pauses.sum_ns
        assert pauses.overlap_ns(0, 1) == 0
    finally:
        pauses.stop()
        pauses.stop()
    count = pauses.pauses.count
    gc.collect()
    assert pauses.pauses.count == count


def test_the_collector_is_spared_what_is_there_and_no_start_waits_for_it():
    gc.collect()
    pauses, phases = GcPauses(), []
    heard = lambda phase, info: phases.append(phase)  # noqa: E731
    gc.callbacks.append(heard)
    try:
        pauses.start(freeze=True)
        assert gc.get_freeze_count() > 1000
        assert not phases, "a collection takes as long as a quarter of the start"
    finally:
        gc.callbacks.remove(heard)
        pauses.stop()
    assert gc.get_freeze_count() == 0


def test_a_full_ring_counts_what_it_loses():
    exchange = Exchange(1000, [])
    rows = []
    for _ in range(300):
        rows.append(next_record(exchange.control, exchange.ring))
        if rows[-1] >= 0:
            exchange.control[13] += 1  # what the loop does after it has filled the row
    assert rows[:256] == list(range(256))
    assert set(rows[256:]) == {-1}
    assert exchange.get(RECORDS_LOST) == 300 - 256
    assert exchange.take_record(10**18) is not None
    assert next_record(exchange.control, exchange.ring) == 0


def test_young_records_wait():
    exchange = Exchange(1000, [])
    exchange.ring[0, 3:6] = (100, 20, 5)
    exchange.control[13] = 1
    assert exchange.take_record(124) is None
    assert exchange.take_record(125).planned_ns == 100
    assert exchange.take_record(125) is None


def test_one_line_for_the_log():
    report = OverrunReport(
        "plant", "late_wake", 7, 2_500_000, 1000, 2, OverrunCause.STOLEN, "stopped"
    )
    assert (
        str(report)
        == "plant started 2.500 ms late in tick 7: stolen, 2 ticks missed, stopped"
    )
