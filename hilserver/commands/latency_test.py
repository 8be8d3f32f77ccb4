"""What this computer can do, before the model is blamed.

Paces an empty plant, as cyclictest does, and prints how late it was woken, with the audit of what
the system grants. No simulation on this computer will be more punctual than this.
"""

import argparse
import asyncio
from dataclasses import asdict

import numpy as np
from numpy.typing import NDArray

from hilserver.bench.report import PERCENTILES, Result, as_json, percentile_us, sparse
from hilserver.commands.options import number, out_file, write_text
from hilserver.errors import EXIT_DONE
from hilserver.monitoring.audit import as_lines, audit
from hilserver.scheduler import OverrunPolicy, RealtimeSettings, Scheduler, Slice
from hilserver.scheduler.empty_step import empty_step
from hilserver.scheduler.realtime import AuditFinding

EXAMPLE = "hilserver latency-test --duration 60 --json latency.json"
_BINS = 20_000
_BAR = 50
_EDGES_US = (1, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, _BINS)
_READING = """\
How to read this: the latency is the actual minus the planned start of a tick, with nothing to
compute. A plant with a period of 1 ms needs the worst latency plus its own execution time below
1000 us. If p99.9 is far below that but the maximum is not, single ticks are late, and are counted.
Short runs look too good: rare delays show only after minutes (--duration) and under real load. In a
virtual machine the hypervisor causes the tail."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add duration, period and the JSON file."""
    parser.add_argument(
        "--duration",
        type=number(0.1, 86_400, "duration between 0.1 s and a day"),
        default=10.0,
        metavar="S",
        help="default 10",
    )
    parser.add_argument(
        "--period-us",
        type=number(50, 1_000_000, "period between 50 us and 1 s", int),
        default=1000,
        metavar="N",
        help="default 1000",
    )
    parser.add_argument(
        "--json", type=out_file, metavar="FILE", help="write figures and raw data"
    )


def run(args: argparse.Namespace) -> int:
    """Measure, print, and write the JSON file if requested."""
    scheduler, items = asyncio.run(measure(args.duration, args.period_us))
    counts = scheduler.statistics.linear_counts
    figures = scheduler.statistics.slice("empty")
    missed = scheduler.statistics.tick.missed_ticks
    print("\n".join(histogram_lines(counts)))
    print(f"\nsamples {figures.count}, missed ticks {missed}")
    for percent in PERCENTILES:
        print(f"  p{percent:<5g} {percentile_us(counts, percent):8.0f} us")
    print(
        f"  max    {figures.latency_max_ns / 1000:8.0f} us (tick {figures.latency_max_tick})"
    )
    print("\n" + "\n".join(as_lines(items)) + "\n\n" + _READING)
    if args.json is not None:
        raw = {
            "histogram_us": sparse(counts),
            "missed_ticks": missed,
            "audit": [asdict(item) for item in items],
        }
        max_us = figures.latency_max_ns / 1000
        results = [
            Result(
                f"wake_latency_p{percent:g}_us", percentile_us(counts, percent), "us"
            )
            for percent in PERCENTILES
        ]
        results = [*results, Result("wake_latency_max_us", max_us, "us", raw=raw)]
        write_text(args.json, as_json(results))
    return EXIT_DONE


async def measure(
    duration_s: float, period_us: int
) -> tuple[Scheduler, list[AuditFinding]]:
    """Pace an empty step for `duration_s`; return the stopped scheduler and the audit."""
    scheduler = Scheduler(
        base_period_ns=period_us * 1000,
        slices=[Slice("empty", 1, compiled=True)],
        step=empty_step,
        values=np.zeros(1),
        words=np.zeros(1, dtype=np.int64),
        policy=OverrunPolicy("skip"),
        realtime=RealtimeSettings(),
        linear_bins=_BINS,
    )
    await scheduler.start()
    try:
        items = audit(scheduler)
        await asyncio.sleep(duration_s)
    finally:
        await scheduler.stop()
    return scheduler, items


def histogram_lines(counts: NDArray[np.int64]) -> list[str]:
    """Return the histogram as lines: range [us], count, bar on a logarithmic scale."""
    lines = []
    low = 0
    tallest = np.log1p(max(int(counts.max(initial=0)), 1) * 10.0)
    for high in _EDGES_US:
        count = int(counts[low:high].sum())
        share = float(np.log1p(count) / tallest)
        bar = "#" * min(_BAR, round(_BAR * share))
        over = high == len(counts)
        span = f"{low:>6} and more" if over else f"{low:>6} to {high:<6}"
        lines.append(f"{span:17} us {count:>10} {bar}".rstrip())
        low = high
    return lines
