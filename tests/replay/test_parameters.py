"""Parameters that changed in a recording change again at their ticks: the same bits."""

import random

import numpy as np
import pytest

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import build
from hilserver.errors import LogError
from hilserver.image import Row
from hilserver.io.recorder import Recorder, Settings
from hilserver.logs import open_writer, read_log
from hilserver.logs.rewriting import rewrite, run_of
from hilserver.parameters import PLANT
from hilserver.replay import Comparison, Engine, assembly_of, plan_exact
from tests.core.test_parameters import AT_A_TICK, TERMS_ON, TURN

CONFIG = {"scheduler": {"backend": "virtual"}, "sensors": {"nav": {"enabled": True}}}
CHANGES = 300


def random_value(name, rng):
    p = PLANT[name]
    low, high = max(p.low, -2.0), min(p.high, 2.0)
    near = (
        p.default * rng.uniform(0.7, 1.3)
        if np.isfinite(p.default) and p.default
        else None
    )
    return p.default if rng.random() < 0.2 else near or rng.uniform(low, high)


async def drive_and_change(core, rng):
    """Drive in turns for 6 s while parameters change, with snapshots and resets between."""
    accepted = 0
    for step in range(CHANGES):
        turn = {name: rpm * rng.choice([-1, 0, 1, 1]) for name, rpm in TURN.items()}
        if step % 20 == 0:
            rows = [
                Row(core.table.slot(f"{n}.setpoint_rpm"), v) for n, v in turn.items()
            ]
            assert core.image.push(rows)
        names = rng.sample(AT_A_TICK, rng.choice([1, 1, 3]))
        values = {name: random_value(name, rng) for name in names}
        accepted += not core.parameters.write("test", values)
        if step == 100:
            await core.snapshots.save("there")
        if step == 200:
            await core.snapshots.load("there")
        if step == 250:
            core.snapshots.reset()
        await core.scheduler.advance(rng.choice([1, 7, 20, 50]))
    return accepted


async def replayed(path):
    log = read_log(path)
    async with Engine(assembly_of(log)) as engine:
        engine.feed_state(in_rows=True)
        for state in log.states:
            engine.check(str(path), log.run["identity"], state.words)
        plan = plan_exact(
            log, engine.table, engine.image.layout, engine.assembly.base_period_ns
        )
        compared = Comparison(log, engine.table, engine.assembly.base_period_ns)
        for stretch in plan.stretches:
            async for batch in engine.play(stretch):
                compared.add(batch)
        return log, compared, plan


@pytest.fixture(scope="module", params=["base", "with terms"])
def assembly(request, tmp_path_factory):
    terms = {} if request.param == "base" else TERMS_ON
    config = Config.model_validate(CONFIG | {"plant": {"terms": terms}})
    return assemble_config(config, tmp_path_factory.mktemp("recorded"))


async def test_random_changes_while_driving_come_again_to_the_bit(assembly):
    path = assembly.folder / "run.mcap"
    async with build(assembly) as core:
        recorder = Recorder(core.image.name, Settings(path))
        core.scheduler.after_batch.append(recorder.look)
        core.image.control.state = 1
        accepted = await drive_and_change(core, random.Random(7))
        recorder.close()
    log, compared, plan = await replayed(path)
    assert compared.difference is None
    # what was loaded is shown at once
    assert compared.n_ticks == plan.n_ticks >= len(log) - 2
    assert accepted > CHANGES // 3
    assert len(log.changes) > CHANGES // 3
    assert set(log.segment) == {0, 1, 2}, (
        "only the snapshot and the reset begin a segment"
    )
    numbers = [change.number for change in log.changes]
    assert numbers == sorted(set(numbers))
    await survives_every_format(log, assembly.folder)


async def survives_every_format(log, folder):
    for name, bag in (("run.csv", None), ("bag", "mcap"), ("again.mcap", None)):
        writer = open_writer(
            folder / name, run_of(log), range(len(log.columns)), bag=bag
        )
        rewrite(log, writer)
        writer.close()
        found, compared, _ = await replayed(folder / name)
        assert compared.difference is None
        assert [c.tick for c in found.changes] == [c.tick for c in log.changes]
        for ours, theirs in zip(found.changes, log.changes, strict=True):
            assert ours.packed.tobytes() == theirs.packed.tobytes()
            assert ours.values == pytest.approx(theirs.values, nan_ok=True)
    beside = folder / "run.csv.parameters.jsonl"
    beside.write_text(beside.read_text().replace('"packed":"', '"packed":"A', 1))
    with pytest.raises(LogError, match="damaged"):
        read_log(folder / "run.csv")
