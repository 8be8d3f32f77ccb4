"""The shield's serial line: rate, lateness of its responses, cost.

A host in a process of its own sends requests to the daemon over a pseudo-terminal. In every block
cyclictest runs at the same time, at the priority of the line's thread. Lateness is from the
earliest time that 115200 baud permit to the write, both stamped by the writer.
"""

import argparse
import asyncio
import json
import os
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilserver.bench import cyclictest
from hilserver.bench.report import (
    PERCENTILES,
    Result,
    median_of_blocks_us,
    percentile_us,
)
from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import FailedError
from hilserver.io.shield import words as w
from hilserver.io.shield.protocol import BYTE_NS, REQUEST_BYTES, RESPONSE_BYTES
from hilserver.program import event_loop

Counts = NDArray[np.int64]
BINS = 10_000
PERIOD_US = 1000
HOST_LIMIT_S = 60.0


@dataclass
class Blocks:
    """Results of the blocks."""

    late: list[Counts] = field(default_factory=list)
    reference: list[Counts] = field(default_factory=list)
    round_trips_ms: list[float] = field(default_factory=list)
    rates_hz: list[float] = field(default_factory=list)
    early: int = 0
    cpu_share: float = 0.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of this bench."""
    parser.add_argument("--blocks", type=int, default=10, help="blocks (default 10)")
    parser.add_argument(
        "--block-s", type=int, default=5, help="seconds per block (default 5)"
    )
    parser.add_argument(
        "--rate", type=float, default=50.0, help="requests per s (default 50)"
    )


def run(args: argparse.Namespace) -> list[Result]:
    """Measure."""
    with tempfile.TemporaryDirectory() as folder:
        config = Config.model_validate(
            {
                "image": {"name": "auto"},
                "page": {"enabled": False},
                "metrics": {"enabled": False},
                "opcua": {"endpoint": "opc.tcp://127.0.0.1:0/hilserver"},
                "shield": {"enabled": True, "link": f"{folder}/shield"},
            }
        )
        blocks = event_loop.run(_measure(args, config, Path(folder)))
    return _results(blocks, args)


async def _measure(args: argparse.Namespace, config: Config, folder: Path) -> Blocks:
    blocks = Blocks()
    priority = max(config.scheduler.realtime.priority - 1, 0)
    command = cyclictest.command(
        period_us=PERIOD_US, priority=priority, duration_s=args.block_s, bins=BINS
    )
    async with Daemon(assemble_config(config, folder)) as daemon:
        shield = daemon.part("shield")
        if shield is None:
            raise FailedError("the shield is not enabled")
        words, begin_s = shield.status.words, time.monotonic()
        before_s = _cpu_s(shield.thread_id)
        for _ in range(args.blocks):
            first = int(words[w.RESPONSES])
            reference, trips_ms = await asyncio.gather(
                asyncio.to_thread(cyclictest.run, command, args.block_s),
                _host(shield.address, args.rate, args.block_s),
            )
            numbers = np.arange(first, int(words[w.RESPONSES])) & (w.STAMPS - 1)
            due_ns, written_ns = words[w.STAMP_ROWS :].reshape(-1, 2)[numbers].T
            late_us = np.clip((written_ns - due_ns) // 1000, 0, BINS - 1)
            blocks.early += int((written_ns < due_ns).sum())
            blocks.late.append(np.bincount(late_us, minlength=BINS))
            blocks.reference.append(reference)
            blocks.round_trips_ms += trips_ms
            span_s = (written_ns[-1] - written_ns[1]) * 1e-9
            blocks.rates_hz.append((len(written_ns) - 2) / span_s)
        used_s = _cpu_s(shield.thread_id) - before_s
        blocks.cpu_share = used_s / (time.monotonic() - begin_s)
    return blocks


async def _host(line: str, rate_hz: float, seconds: float) -> list[float]:
    module = ("-m", "benchmarks.shield_host", line, str(rate_hz), str(seconds))
    process = await asyncio.create_subprocess_exec(
        sys.executable, *module, stdout=asyncio.subprocess.PIPE
    )
    try:
        async with asyncio.timeout(seconds + HOST_LIMIT_S):
            out, _ = await process.communicate()
    finally:
        if process.returncode is None:
            process.kill()
    trips_ms: list[float] = json.loads(out)
    return trips_ms


def _cpu_s(thread_id: int) -> float:
    """Return the processor time of a thread of this process [s]."""
    text = Path(f"/proc/self/task/{thread_id}/stat").read_text(encoding="ascii")
    user, system = text.rpartition(")")[2].split()[11:13]
    return (int(user) + int(system)) / os.sysconf("SC_CLK_TCK")


def _results(blocks: Blocks, args: argparse.Namespace) -> list[Result]:
    line_ms = (REQUEST_BYTES + RESPONSE_BYTES["iotbot"]) * BYTE_NS * 1e-6 + 1.0
    results = [
        Result(
            "shield_rate_hz",
            float(np.median(blocks.rates_hz)),
            "Hz",
            args.rate,
            "asked for",
        ),
        Result("shield_early_responses", blocks.early, "", 0.0, "the line"),
    ]
    for percent in PERCENTILES:
        value = median_of_blocks_us(blocks.late, percent)
        reference = median_of_blocks_us(blocks.reference, percent)
        raw = {
            "blocks_us": [percentile_us(block, percent) for block in blocks.late],
            "reference_blocks_us": [
                percentile_us(block, percent) for block in blocks.reference
            ],
        }
        name, ratio = f"shield_lateness_p{percent:g}_us", value / max(reference, 1.0)
        results.append(Result(name, value, "us", reference, "cyclictest", ratio, raw))
    for percent in (50.0, 99.0):
        trip_ms = float(np.percentile(blocks.round_trips_ms, percent))
        name, ratio = f"shield_round_trip_p{percent:g}_ms", trip_ms / line_ms
        results.append(Result(name, trip_ms, "ms", line_ms, "the line", ratio))
    results.append(Result("shield_thread_cpu_pct", 100.0 * blocks.cpu_share, "%"))
    return results
