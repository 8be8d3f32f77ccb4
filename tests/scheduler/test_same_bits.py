"""The same writes at the same ticks give the same bits in all three back ends."""

import numpy as np
import pytest

from tests.scheduler.kernels import HASH, N_ROWS, SCHEDULE, recorded_writes_step
from tests.scheduler.rig import running

N_TICKS, N_WRITES = 10_000, 1_000


def schedule(moved=None):
    rng = np.random.default_rng(20)
    rows = np.stack(
        [rng.integers(1, N_TICKS, N_WRITES), rng.integers(1, 900, N_WRITES)], axis=1
    )
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    if moved is not None:
        rows[moved, 0] += 1
        rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return rows


async def run(backend, rows):
    def prepare(rig):
        rig.words[N_ROWS] = len(rows)
        rig.words[SCHEDULE : SCHEDULE + rows.size] = rows.ravel()

    async with running(
        recorded_writes_step, backend=backend, paused=True, prepare=prepare
    ) as rig:
        rig.scheduler.set_speed(10.0)  # pacing scales, the ticks stay what they are
        await rig.scheduler.advance(N_TICKS)
        assert rig.scheduler.tick == N_TICKS
        assert np.abs(rig.values[4:7]).min() > 0.0
        return int(rig.words[HASH])


async def test_three_back_ends_give_one_hash():
    rows = schedule()
    expected = await run("virtual", rows)
    assert await run("timerfd", rows) == expected
    assert await run("thread", rows) == expected


@pytest.mark.parametrize("moved", [0, 500, N_WRITES - 1])
async def test_one_write_a_tick_later_changes_the_hash(moved):
    assert await run("virtual", schedule(moved)) != await run("virtual", schedule())
