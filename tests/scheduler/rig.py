"""A scheduler over one of the test kernels, with everything that needs permission left out."""

import asyncio
import contextlib
from dataclasses import dataclass, field

import numpy as np

from hilserver.scheduler import RealtimeSettings, Scheduler, Slice

QUIET = RealtimeSettings(priority=0, lock_memory=False, hold_latency_target=False)
SLICES = (
    Slice("plant", 1, True),
    Slice("sensors", 10, True),
    Slice("publish", 20, False),
    Slice("supervise", 100, False),
)


@dataclass
class Rig:
    scheduler: Scheduler
    values: np.ndarray
    words: np.ndarray
    reports: list = field(default_factory=list)


@contextlib.asynccontextmanager
async def running(step, *, backend="thread", slices=SLICES, prepare=None, **options):
    """Start a scheduler, stop it at the end whatever happens; nothing may be left behind."""
    rig = make(step, backend=backend, slices=slices, **options)
    if prepare is not None:
        prepare(rig)
    try:
        await rig.scheduler.start()
        yield rig
    finally:
        await rig.scheduler.stop()


def make(step, *, backend="thread", slices=SLICES, **options):
    values, words = np.zeros(64), np.zeros(4096, dtype=np.int64)
    settings = {"base_period_ns": 1_000_000, "realtime": QUIET, "freeze_gc": False}
    scheduler = Scheduler(
        slices=slices,
        step=step,
        values=values,
        words=words,
        backend=backend,
        **(settings | options),
    )
    rig = Rig(scheduler, values, words)
    scheduler.on_overrun(rig.reports.append)
    return rig


async def until(condition, timeout_s=120.0):
    """Wait for a condition of a running scheduler; fails with a time-out."""
    async with asyncio.timeout(timeout_s):
        while not condition():  # noqa: ASYNC110 - compiled code sets no event
            await asyncio.sleep(0.002)
