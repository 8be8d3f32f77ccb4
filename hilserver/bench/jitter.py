"""Wake latency of the paced plant against cyclictest, in alternating blocks.

Blocks of the subject and of cyclictest alternate at the same period, priority and load, and for
each percentile the medians over the blocks are compared: a shared computer's tail affects both.

The load is the same in both kinds of blocks. The daemon keeps pacing, publishing and serving its
clients while cyclictest runs, but its pacing thread then has no real-time priority. While the
daemon is measured, a second cyclictest without real-time priority runs beside it. So there is
always one measured real-time thread and one ordinary thread of the same period.
"""

import argparse
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.bench import cyclictest, report
from hilserver.bench.jitter_subjects import (
    Companion,
    Subject,
    bare_pacing,
    loaded_daemon,
)

Counts = NDArray[np.int64]
SUBJECTS: dict[str, Callable[..., AbstractContextManager[Subject]]] = {
    "daemon": loaded_daemon,
    "pacing": bare_pacing,
}


@dataclass
class BackEndBlocks:
    """The blocks of one back end."""

    backend: str
    command: list[str] = field(default_factory=list)
    load: list[str] = field(default_factory=list)
    subject: list[Counts] = field(default_factory=list)
    reference: list[Counts] = field(default_factory=list)

    def result(self, percent: float, prefix: str) -> report.Result:
        """Return the figure for one percentile."""
        value = report.median_of_blocks_us(self.subject, percent)
        reference = report.median_of_blocks_us(self.reference, percent)
        ratio = value / reference if reference > 0 else None
        ours_us = [report.percentile_us(block, percent) for block in self.subject]
        reference_us = [
            report.percentile_us(block, percent) for block in self.reference
        ]
        interval = report.ratio_interval(self.subject, self.reference, percent)
        raw = {
            "backend": self.backend,
            "ratio_interval_95": interval,
            "blocks_us": ours_us,
            "reference_blocks_us": reference_us,
        }
        return report.Result(
            name=f"{prefix}wake_latency_p{percent:g}_us",
            value=value,
            unit="us",
            reference=reference,
            reference_name="cyclictest",
            ratio=ratio,
            raw=raw,
        )

    @property
    def raw(self) -> dict[str, Any]:
        """All measured data: latency [us] -> count, per block."""
        histograms = [report.sparse(block) for block in self.subject]
        of_cyclictest = [report.sparse(block) for block in self.reference]
        return {
            "cyclictest_command": self.command,
            "load": self.load,
            "histograms": histograms,
            "cyclictest_histograms": of_cyclictest,
        }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of this bench."""
    parser.add_argument(
        "--blocks", type=int, default=10, help="blocks of each (default 10)"
    )
    parser.add_argument(
        "--block-s", type=int, default=5, help="seconds per block (default 5)"
    )
    parser.add_argument(
        "--period-us", type=int, default=1000, help="period (default 1000)"
    )
    parser.add_argument(
        "--priority", type=int, default=80, help="SCHED_FIFO priority (default 80)"
    )
    parser.add_argument(
        "--subject",
        choices=sorted(SUBJECTS),
        default="daemon",
        help="the daemon under OPC UA load (default), or the bare pacing loop",
    )
    parser.set_defaults(beside=())
    parser.add_argument(
        "--backend",
        choices=("thread", "timerfd", "both"),
        default="both",
        help="back end to measure (default: both, one after the other)",
    )


def run(args: argparse.Namespace) -> list[report.Result]:
    """Measure; the raw histograms are in the first figure of each back end."""
    results = []
    for backend in ("thread", "timerfd") if args.backend == "both" else (args.backend,):
        for beside in dict.fromkeys(((), args.beside)):
            comparison = compare(args, backend, beside)
            prefix = "with_" * bool(beside) + (
                "" if backend == "thread" else f"{backend}_"
            )
            figures = [
                comparison.result(percent, prefix) for percent in report.PERCENTILES
            ]
            figures[0].raw.update(comparison.raw)
            results += figures
    return results


def compare(
    args: argparse.Namespace, backend: str, beside: tuple[Companion, ...] = ()
) -> BackEndBlocks:
    """Measure one back end and cyclictest in alternating blocks."""
    comparison = BackEndBlocks(backend)
    # If cyclictest is missing, fail before anything is started.
    cyclictest.command(period_us=1, priority=0, duration_s=1, bins=1)
    subject_of = SUBJECTS[args.subject]
    how: dict[str, Any] = {"period_us": args.period_us, "priority": args.priority}
    with subject_of(backend, **how, beside=beside) as subject:
        comparison.load = subject.load
        bins = len(subject.statistics.linear_counts)
        # The event loop has no real-time priority; cyclictest then runs at the requested one.
        priority = subject.priority if backend == "thread" else args.priority
        comparison.command = cyclictest.command(
            period_us=args.period_us,
            priority=priority,
            duration_s=args.block_s,
            bins=bins,
        )
        for block in range(args.blocks):
            _progress(f"{backend}: block {block + 1} of {args.blocks}")
            with cyclictest.companion(
                period_us=args.period_us, duration_s=args.block_s
            ):
                comparison.subject.append(subject.measure(args.block_s))
            with subject.standing_back():
                comparison.reference.append(
                    cyclictest.run(comparison.command, args.block_s)
                )
        _progress("")
    return comparison


def _progress(text: str) -> None:
    if sys.stderr.isatty():
        print(f"\r{text:50}", end="" if text else "\r", file=sys.stderr, flush=True)
    elif text:
        print(text, file=sys.stderr, flush=True)
