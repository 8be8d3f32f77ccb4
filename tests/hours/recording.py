"""A recording of the town, and whether its replay gives the same bits."""

import asyncio
from pathlib import Path

from hilserver.io.recorder.recorder import Recorder
from hilserver.io.recorder.series import Settings
from hilserver.logs.reading import read_log
from hilserver.replay import Comparison, Engine, assembly_of, plan_exact


def recorder_of(image: str, path: Path) -> Recorder:
    """Return a recorder of everything; its `look` has to be called once per ring of frames."""
    return Recorder(image, Settings(path=path, signals=("*",), waits=True))


def difference(path: Path) -> str:
    """Replay a recording; return where its outputs differ, empty if nowhere."""
    return asyncio.run(_difference(path))


async def _difference(path: Path) -> str:
    log = read_log(path)
    assembly = assembly_of(log, None)
    period_ns = assembly.base_period_ns
    async with Engine(assembly) as engine:
        plan = plan_exact(log, engine.table, engine.image.layout, period_ns)
        comparison = Comparison(log, engine.table, period_ns)
        engine.feed_state(in_rows=plan.feeds_state)
        for stretch in plan.stretches:
            async for batch in engine.play(stretch):
                comparison.add(batch)
    if not comparison.n_ticks:
        return "nothing of it can be replayed"
    return comparison.difference or ""
