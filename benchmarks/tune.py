"""Effect of parameter changes on pacing: blocks with 20 changes a second and without alternate.

The daemon serves the OPC UA clients of `bench jitter` all the time. Another client changes two
parameters in each Write during a block with changes, and rests in the next one.
"""

import argparse
import asyncio
import contextlib
import statistics
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any, Final

import numpy as np
import yaml
from asyncua import Client, ua
from numpy.typing import NDArray

from hilserver.bench.jitter_subjects import Companion, Place, loaded_daemon
from hilserver.bench.report import Result
from hilserver.errors import FailedError
from hilserver.program.children import piped, python
from hilserver.sweep.estimates import LEAST_MACHINES, median_interval

RATE_HZ, PERCENT, MOST = 20.0, 99.9, 1.25
VALUES: Final = {
    "plant.controller.k_p": (12.0, 14.0),
    "terms.rotation_gain": (-0.2, 0.0),
}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add all options."""
    parser.add_argument(
        "--blocks", type=int, default=20, help="of each kind (default 20)"
    )
    parser.add_argument(
        "--block-s", type=int, default=5, help="seconds per block (default 5)"
    )
    parser.add_argument(
        "--priority", type=int, default=80, help="SCHED_FIFO (default 80)"
    )


def run(args: argparse.Namespace) -> list[Result]:
    """Measure; return the ratio of the percentiles with its interval."""
    tuner = _Tuner()
    company = Companion("control", lambda _: {"source": "opcua"}, tuner.busy)
    return alternating("tune", company, tuner.say, args)


def alternating(
    name: str, company: Companion, say: Callable[[str], None], args: argparse.Namespace
) -> list[Result]:
    """Measure blocks in which a process rests and blocks in which it works, in turn.

    Parameters
    ----------
    say : callable
        Called with ``rest`` or ``change`` before each block.
    """
    pairs = []
    with loaded_daemon(
        "thread", period_us=1000, priority=args.priority, beside=(company,)
    ) as subject:
        for _ in range(args.blocks):
            pair = []
            for order in ("rest", "change"):
                say(order)
                pair.append(_percentile_us(subject.measure(args.block_s)))
            pairs.append(pair)
    ratios = np.array([busy / idle for idle, busy in pairs])
    value, low, high = float(np.median(ratios)), float("nan"), float("nan")
    if len(ratios) >= LEAST_MACHINES:
        value, low, high = median_interval(ratios)
    idle, busy = (statistics.median(column) for column in zip(*pairs, strict=True))
    text = f"required of the upper end; {low:.3f} .. {high:.3f}"
    return [
        Result(
            f"{name}_wake_p99.9_us", busy, "us", idle, "at rest", busy / idle, pairs
        ),
        Result(f"{name}_wake_ratio", value, "1", MOST, text, value / MOST),
    ]


def _percentile_us(histogram: NDArray[np.int64]) -> float:
    """Return the percentile of wake latencies in bins of 1 us."""
    total = np.cumsum(histogram)
    return float(np.searchsorted(total, total[-1] * PERCENT / 100.0)) + 0.5


class _Tuner:
    """A process that changes parameters while it is asked to."""

    @contextlib.contextmanager
    def busy(self, place: Place) -> Iterator[str]:
        """Run it."""
        config = yaml.safe_load(
            (place.folder / "config.yaml").read_text(encoding="utf-8")
        )
        command = python("-m", "benchmarks.tune", config["opcua"]["endpoint"])
        with piped(command, name="the client that tunes") as self._process:
            yield f"{RATE_HZ:g} changes of {len(VALUES)} parameters a second in every second block"
            if self._process.poll() is not None:
                raise FailedError(
                    "the client that tunes has ended: the load was not there"
                )

    def say(self, order: str) -> None:
        """Let it change parameters, or rest."""
        process: subprocess.Popen[str] = self._process
        assert process.stdin is not None
        process.stdin.write(order + "\n")
        process.stdin.flush()


async def _tune(url: str) -> None:
    """Change parameters while the last line on standard input is ``change``."""
    lines: asyncio.Queue[str] = asyncio.Queue()
    loop = asyncio.get_running_loop()
    loop.add_reader(sys.stdin, lambda: lines.put_nowait(sys.stdin.readline()))
    async with Client(url) as client:
        ns, order, n = (
            await client.get_namespace_index("urn:hilserver:robot"),
            "rest",
            0,
        )
        nodes = [client.get_node(f"ns={ns};s=parameters.{name}") for name in VALUES]
        ends: Any = list(zip(*VALUES.values(), strict=True))
        while order:
            while not lines.empty():
                order = (await lines.get()).strip()
            if order == "change":
                n += 1
                values = [ua.Variant(v, ua.VariantType.Double) for v in ends[n % 2]]
                await client.write_values(nodes, values)
            await asyncio.sleep(1.0 / RATE_HZ)


if __name__ == "__main__":
    asyncio.run(_tune(sys.argv[1]))
