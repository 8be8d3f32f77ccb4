"""Cost of the mechatronic model: a step compared with plain mj_step, and the plant's wake latency.

Both step the same model, in alternating blocks. For the latency, paced plants without the body,
with it, and again without it take turns; the ratio of their p99 is given with its 95 % bootstrap
interval over the rounds, next to the ratio of the two plants without the body, which shows the
variation of the computer itself.
"""

import argparse
import asyncio
import statistics
import time
from collections.abc import Callable

import numpy as np

from hilserver.arrays import Array
from hilserver.bench.report import Result
from hilserver.body.engine import BodyEngine
from hilserver.body.layout import Addresses, BodyMotion, Constants
from hilserver.body.parameters import BodyParameters
from hilserver.body.step import advance
from hilserver.compiled import kernel
from hilserver.compiled.foreign import call
from hilserver.config.root import Config
from hilserver.daemon.assembly import Assembly, assemble_config
from hilserver.daemon.builder import Pace, build
from hilserver.plant.parameters import RobotParameters
from hilserver.scheduler import OverrunPolicy, RealtimeSettings

BLOCKS, STEPS = 20, 2000
SETTLE_S = 1.0
DRAWS = 2000


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add ``--pairs``, ``--block-s`` and ``--priority``."""
    parser.add_argument(
        "--pairs", type=int, default=20, help="rounds of latency; 0: none"
    )
    parser.add_argument(
        "--block-s", type=float, default=5.0, help="length of a block [s]"
    )
    parser.add_argument("--priority", type=int, default=80, help="SCHED_FIFO; 0: none")


@kernel()
def _ours(p: Constants, b: Array, a: Addresses, slices: int) -> None:
    for _ in range(slices):
        advance(p, b, a)


@kernel()
def _plain(a: Addresses, steps: int) -> None:
    for _ in range(steps):
        call(a.step, a.model, a.memory, 0, 0)


def _block_us(run: Callable[[], None]) -> float:
    start_ns = time.perf_counter_ns()
    run()
    return (time.perf_counter_ns() - start_ns) * 1e-3 / STEPS


def _cost() -> Result:
    body = BodyParameters(robot=RobotParameters())
    engine = BodyEngine(body)
    p, b, a = engine.parameters, engine.initial, engine.addresses
    BodyMotion.of(b).asked[:] = 3.0, 3.0, 5.0, 5.0
    _ours(p, b, a, 100)
    _plain(a, 100)
    ours, plain = [], []
    for _ in range(BLOCKS):
        ours.append(_block_us(lambda: _ours(p, b, a, STEPS // body.steps)))
        plain.append(_block_us(lambda: _plain(a, STEPS)))
    value, reference = statistics.median(ours), statistics.median(plain)
    raw = {"ours_us": ours, "plain_us": plain}
    name = "body_step_us"
    return Result(name, value, "us", reference, "mj_step alone", value / reference, raw)


async def _p99_us(assembly: Assembly, block_s: float, priority: int) -> float:
    pace = Pace(
        backend="thread",
        policy=OverrunPolicy("skip"),
        realtime=RealtimeSettings(priority=priority),
        paused=False,
    )
    async with build(assembly, pace) as core:
        await asyncio.sleep(SETTLE_S)
        before = core.scheduler.statistics.linear_counts
        await asyncio.sleep(block_s)
        counts = np.cumsum(core.scheduler.statistics.linear_counts - before)
    return float(np.searchsorted(counts, 0.99 * counts[-1]) + 1)


def _interval(ratios: Array) -> tuple[float, float]:
    """Return the 95 % interval of the median ratio."""
    random = np.random.default_rng(0)
    drawn = np.median(random.choice(ratios, (DRAWS, len(ratios))), axis=1)
    low, high = np.quantile(drawn, (0.025, 0.975))
    return float(low), float(high)


async def _latencies(pairs: int, block_s: float, priority: int) -> list[Result]:
    idle = assemble_config(Config())
    body = assemble_config(Config.model_validate({"mechatronic": {"enabled": True}}))
    rows = [
        [await _p99_us(who, block_s, priority) for who in (idle, body, idle)]
        for _ in range(pairs)
    ]
    p99 = np.array(rows)
    results = []
    for name, column in (("p99_with_body", 1), ("p99_without_again", 2)):
        ratios = p99[:, column] / p99[:, 0]
        value, reference = np.median(p99[:, column]), np.median(p99[:, 0])
        raw = {"p99_us": p99[:, (0, column)].tolist(), "ratio_ci95": _interval(ratios)}
        ratio = float(np.median(ratios))
        results.append(
            Result(
                name,
                float(value),
                "us",
                float(reference),
                "without the body",
                ratio,
                raw,
            )
        )
    return results


def run(args: argparse.Namespace) -> list[Result]:
    """Measure and return ``body_step_us``, ``p99_with_body`` and ``p99_without_again``."""
    results = [_cost()]
    if args.pairs > 0:
        results += asyncio.run(_latencies(args.pairs, args.block_s, args.priority))
    return results
