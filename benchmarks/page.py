"""Cost of the operator page: its server, the plant's deadlines, and the browser.

The robot drives the demo's figure of eight. Blocks in which twenty clients take thirty frames a
second alternate with blocks without clients; a third kind, also without clients, shows the
variation of the computer itself. Short by default; ``--full`` for the figures that are quoted.
"""

import argparse
import asyncio
import contextlib
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from benchmarks import page_browser
from benchmarks.target import running_daemon
from hilserver.bench.jitter_subjects import Subject
from hilserver.bench.report import (
    Result,
    median_of_blocks_us,
    percentile_us,
    ratio_interval,
)
from hilserver.errors import FailedError
from hilserver.image import ImageReader
from hilserver.program.children import free_port, piped, python
from hilserver.scheduler import Statistics

RATE_HZ = 30.0
COUNTS = (1, 3, 20)
SETTLE_S = 1.0
LAZY_S = 5.0
_PERCENT = 99.0
Counts = NDArray[np.int64]


@dataclass
class Clients:
    """A process with several clients."""

    process: "subprocess.Popen[str]"

    def tell(self, word: str) -> list[int]:
        """Send an order; return how many frames each client has received so far."""
        stdin, stdout = self.process.stdin, self.process.stdout
        if stdin is None or stdout is None:
            raise FailedError("the clients have no pipes")
        stdin.write(f"{word}\n")
        stdin.flush()
        line = stdout.readline()
        if not line:
            raise FailedError("the clients of the page have failed")
        return [int(count) for count in json.loads(line)]


@dataclass
class Server:
    """The page's process."""

    pid: int

    def used_s(self) -> float:
        """Return its processor time so far [s]."""
        text = Path(f"/proc/{self.pid}/stat").read_text(encoding="ascii")
        words = text.rpartition(")")[2].split()
        return (int(words[11]) + int(words[12])) / os.sysconf("SC_CLK_TCK")

    def private_mb(self) -> float:
        """Return its private memory [MB]."""
        text = Path(f"/proc/{self.pid}/smaps_rollup").read_text(encoding="ascii")
        lines = (
            line.split() for line in text.splitlines() if line.startswith("Private_")
        )
        return sum(int(words[1]) for words in lines) * 1024 / 1e6


@dataclass
class Blocks:
    """Wake latencies of the plant, block by block."""

    idle: list[Counts] = field(default_factory=list)
    again: list[Counts] = field(default_factory=list)
    watched: list[Counts] = field(default_factory=list)

    def result(self, watched: list[Counts], name: str) -> Result:
        """Return the ratio of the 99th percentiles of a kind of blocks and of the idle ones."""
        value = median_of_blocks_us(watched, _PERCENT)
        idle = median_of_blocks_us(self.idle, _PERCENT)
        raw = {
            "ratio_interval_95": ratio_interval(watched, self.idle, _PERCENT),
            "blocks_us": [percentile_us(block, _PERCENT) for block in watched],
            "reference_blocks_us": [
                percentile_us(block, _PERCENT) for block in self.idle
            ],
        }
        return Result(
            name, value, "us", idle, "idle blocks", value / max(idle, 1.0), raw
        )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the size of the load."""
    parser.add_argument(
        "--full", action="store_true", help="20 pairs of 5 s, 100,000 frames"
    )
    parser.add_argument(
        "--pairs", type=int, help="alternating blocks (default 4, full 20)"
    )
    parser.add_argument(
        "--block-s", type=float, help="length of one (default 2, full 5)"
    )
    parser.add_argument("--no-browser", action="store_true", help="without Chromium")


def run(args: argparse.Namespace) -> list[Result]:
    """Measure, and return the figures."""
    return asyncio.run(_measure(args))


async def _measure(args: argparse.Namespace) -> list[Result]:
    pairs, block_s = (
        args.pairs or (20 if args.full else 4),
        args.block_s or (5 if args.full else 2),
    )
    load = os.getloadavg()[0]
    image, port = f"bench-page-{os.getpid()}", free_port()
    # it has to keep driving
    limits = {"single_overrun_ms": None, "consecutive_overruns": None}
    settings = {
        "page": {"port": port, "rate_hz": RATE_HZ},
        "scheduler": {"policy": "skip", "limits": limits},
    }
    url = f"http://127.0.0.1:{port}/"
    async with running_daemon(settings, image, "--demo") as (_, daemon):
        server = Server(_page_of(daemon.pid))
        _, words = ImageReader.attach(image).region("statistics")
        plant = Subject(Statistics.attach(words))
        results = [Result("load_before", load, "1")]
        results += [_cpu(server, url, n, 2 * block_s) for n in COUNTS]
        results += _plant(server, plant, url, pairs, block_s)
        results.append(_lazy(url))
        if not args.no_browser:
            frames = 100_000 if args.full else 10_000
            results += await page_browser.measure(url, RATE_HZ, 2 * block_s, frames)
    return results


def _page_of(pid: int) -> int:
    """Return the page's process of a daemon."""
    for task in Path(f"/proc/{pid}/task").iterdir():
        for child in (task / "children").read_text(encoding="ascii").split():
            if b"--beside" in Path(f"/proc/{child}/cmdline").read_bytes():
                return int(child)
    raise FailedError("the daemon has no page")


@contextlib.contextmanager
def _clients(url: str, n: int) -> Iterator[Clients]:
    command = python("-m", "benchmarks.page_clients", url, str(n))
    with piped(command, name="the clients of the page") as process:
        clients = Clients(process)
        clients.tell("connect")
        yield clients


def _cpu(server: Server, url: str, n: int, seconds: float) -> Result:
    _say(f"{n} clients")
    with _clients(url, n) as clients:
        time.sleep(SETTLE_S)
        before_s, before = server.used_s(), sum(clients.tell("count"))
        time.sleep(seconds)
        used_s, frames = server.used_s() - before_s, sum(clients.tell("count")) - before
    raw = {"frames_per_client_per_s": frames / n / seconds}
    return Result(f"server_cpu_{n}_clients_pct", 100 * used_s / seconds, "%", raw=raw)


def _plant(
    server: Server, plant: Subject, url: str, pairs: int, block_s: float
) -> list[Result]:
    blocks = Blocks()
    with _clients(url, COUNTS[-1]) as clients:
        time.sleep(SETTLE_S)
        first_mb, first = server.private_mb(), sum(clients.tell("count"))
        for pair in range(pairs):
            _say(f"pair {pair + 1} of {pairs}")
            blocks.watched.append(plant.measure(block_s))
            clients.tell("disconnect")
            time.sleep(SETTLE_S)
            blocks.idle.append(plant.measure(block_s))
            blocks.again.append(plant.measure(block_s))
            clients.tell("connect")
            time.sleep(SETTLE_S)
        frames = sum(clients.tell("count")) - first
        grown_mb = server.private_mb() - first_mb
    watched = blocks.result(blocks.watched, "plant_wake_p99_20_clients_us")
    again = blocks.result(blocks.again, "plant_wake_p99_idle_us")
    above = watched.raw["ratio_interval_95"][1] - again.raw["ratio_interval_95"][1]
    return [
        watched,
        again,
        Result(
            "p99_ratio_above_idle", above, "1", raw={"pairs": pairs, "block_s": block_s}
        ),
        Result("server_heap_growth_mb", grown_mb, "MB", raw={"frames": frames}),
    ]


def _lazy(url: str) -> Result:
    """One of three clients stops reading: the rate of the others, compared with that before."""
    _say("a client that stops reading")
    with _clients(url, 3) as clients:
        rates = []
        lost = 0
        for word in ("count", "stop"):
            time.sleep(SETTLE_S)
            before = clients.tell(word)
            time.sleep(LAZY_S)
            now = clients.tell("count")
            rates.append(statistics.mean(now[i] - before[i] for i in (1, 2)) / LAZY_S)
            lost = round(rates[-1] * LAZY_S) - (now[0] - before[0])
        clients.tell("go")
    raw = {"lost_frames": lost}
    return Result(
        "frames_beside_a_lazy_client",
        rates[1],
        "1/s",
        rates[0],
        "before",
        rates[1] / rates[0],
        raw,
    )


def _say(text: str) -> None:
    print(f"page: {text}", file=sys.stderr, flush=True)
