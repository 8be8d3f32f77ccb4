"""The same inputs at the same ticks give the same bits, in every pacing back end and process."""

import asyncio
import hashlib
import random
import subprocess
import sys
from pathlib import Path

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.builder import Pace, build
from hilserver.image import Row

N_TICKS = 10_000
N_WRITES = 1_000
WRITTEN = ("wheel.fl.setpoint_rpm", "wheel.rl.setpoint_rpm", "wheel.fr.setpoint_rpm")
CONFIG = {
    "sensors": {"nav": {"enabled": True}},
}


class Bench:
    """Plant, image and scheduler, without a daemon around them."""

    def __init__(self, backend, snapshots="snapshots"):
        settings = CONFIG | {"snapshots": {"folder": str(snapshots)}}
        self.assembly = assemble_config(Config.model_validate(settings))
        self.core = build(self.assembly, Pace(backend=backend))
        self.table, self.image = self.assembly.table, self.core.image
        self.scheduler = self.core.scheduler
        if backend != "virtual":
            self.scheduler.set_speed(10)

    async def __aenter__(self):
        await self.core.__aenter__()
        return self

    async def __aexit__(self, *_):
        await self.core.__aexit__()

    def push(self, writes):
        rows = [
            Row(self.table.slot(name), value, tick=tick) for tick, name, value in writes
        ]
        assert self.image.push_timed(rows)

    def hash_from(self, first_tick):
        digest = hashlib.sha256()
        for number in range(self.image.head):
            frame = self.image.frame(number)
            if frame.tick >= first_tick:
                digest.update(frame.values.tobytes() + frame.status.tobytes())
        return digest.hexdigest()


def recorded_writes():
    rng = random.Random(1)
    ticks = sorted(rng.choices(range(N_TICKS), k=N_WRITES))
    return [(tick, rng.choice(WRITTEN), rng.uniform(-90, 90)) for tick in ticks]


async def drive(backend, writes):
    async with Bench(backend) as bench:
        bench.push(writes)
        async with asyncio.timeout(120):
            await bench.scheduler.advance(N_TICKS)
        assert bench.image.head == N_TICKS
        return bench.hash_from(0)


async def test_three_back_ends_give_the_same_bits_and_a_moved_write_gives_others():
    writes = recorded_writes()
    virtual = await drive("virtual", writes)
    assert await drive("timerfd", writes) == virtual
    assert await drive("thread", writes) == virtual
    tick, name, value = writes[500]
    moved = sorted([*writes[:500], (tick + 1, name, value), *writes[501:]])
    assert await drive("virtual", moved) != virtual


async def continue_from(folder, first_tick):
    """Run on from the snapshot; called in a process of its own."""
    async with Bench("virtual", folder) as bench:
        assert await bench.core.snapshots.load("middle") == first_tick
        bench.push([w for w in recorded_writes() if w[0] >= first_tick])
        await bench.scheduler.advance(N_TICKS - first_tick)
        return bench.hash_from(first_tick)


async def test_a_snapshot_continues_bit_exactly_in_a_new_process(tmp_path):
    first_tick = 4_321
    async with Bench("virtual", tmp_path) as bench:
        bench.push(recorded_writes())
        await bench.scheduler.advance(first_tick)
        await bench.core.snapshots.save("middle")
        await bench.scheduler.advance(N_TICKS - first_tick)
        expected = bench.hash_from(first_tick)
    code = (
        "import asyncio; from tests.test_determinism import continue_from;"
        f"print(asyncio.run(continue_from({str(tmp_path)!r}, {first_tick})))"
    )
    run = await asyncio.to_thread(
        subprocess.run,
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        timeout=600,
        cwd=Path(__file__).parent.parent,
        check=False,
    )
    assert run.returncode == 0, run.stderr
    assert run.stdout.strip() == expected
