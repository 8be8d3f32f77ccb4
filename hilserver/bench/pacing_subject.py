"""A process that only paces: an empty step, and a busy event loop.

``python -m hilserver.bench.pacing_subject BACKEND FILE PERIOD_US PRIORITY`` paces until its
standard input ends; its statistics are in FILE.
"""

import asyncio
import json
import sys
from pathlib import Path

import numpy as np
import uvloop

from hilserver.scheduler import (
    OverrunPolicy,
    RealtimeSettings,
    Scheduler,
    Slice,
    map_statistics,
    words_needed,
)
from hilserver.scheduler.empty_step import empty_step
from hilserver.tasks import Supervisor

HISTOGRAM_BINS = 10_000
SLICES = (
    Slice("plant", 1, compiled=True),
    Slice("sensors", 10, compiled=True),
    Slice("publish", 20, compiled=False),
)


async def pace(backend: str, path: Path, period_us: int, priority: int) -> None:
    """Pace until standard input ends."""
    statistics = map_statistics(path, words_needed(len(SLICES), HISTOGRAM_BINS))
    scheduler = Scheduler(
        base_period_ns=period_us * 1000,
        slices=SLICES,
        step=empty_step,
        values=np.zeros(64),
        words=np.zeros(64, dtype=np.int64),
        backend=backend,
        policy=OverrunPolicy("skip"),  # like cyclictest: one late wake-up is one sample
        realtime=RealtimeSettings(priority=priority),
        statistics_array=statistics,
        linear_bins=HISTOGRAM_BINS,
    )
    await scheduler.start()
    async with Supervisor() as tasks:
        for _ in range(3):
            tasks.keep("work", _work)
        try:
            await asyncio.to_thread(sys.stdin.read)
        finally:
            await scheduler.stop()


async def _work() -> None:
    """Keep the event loop about as busy as a server with a few clients."""
    while True:
        for _ in range(20):
            json.loads(json.dumps(list(range(200))))
            await asyncio.sleep(0)
        await asyncio.sleep(0.004)


if __name__ == "__main__":
    uvloop.run(pace(sys.argv[1], Path(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])))
