"""Virtual time: exact slices over a million ticks, batches that yield, lockstep."""

import asyncio

import numpy as np
import pytest

from hilserver.scheduler import Slice
from hilserver.scheduler.scheduler import PeerSilentError
from tests.scheduler.kernels import (
    FAULTS,
    JUMP_TO,
    LAST_FAULT,
    LATCHES,
    PUBLISHES,
    counting_step,
)
from tests.scheduler.rig import make, running, until

MILLION = 1_000_000
PERIODS = (1, 2, 5, 10, 100)


async def test_a_million_ticks_run_every_slice_exactly():
    slices = [Slice(f"s{p}", p, True) for p in PERIODS] + [Slice("publish", 100, False)]
    stamps = []

    def prepare(rig):
        rig.scheduler.on_slice(
            "publish", lambda tick, planned: stamps.append((tick, planned))
        )

    async with running(
        counting_step, backend="virtual", slices=slices, paused=True, prepare=prepare
    ) as rig:
        await rig.scheduler.advance(MILLION)
        assert rig.scheduler.tick == MILLION
        assert rig.words[PUBLISHES] == MILLION
        for i, period in enumerate(PERIODS):
            runs = MILLION // period
            assert rig.words[i] == runs
            # the right ticks
            assert rig.words[50 + i] == period * runs * (runs - 1) // 2
            figures = rig.scheduler.statistics.slice(f"s{period}")
            assert (figures.count, figures.missed_ticks) == (runs, 0)
            assert figures.execution_counts.sum() == runs
        ticks, planned = np.array(stamps).T
        assert np.array_equal(ticks, np.arange(0, MILLION, 100))
        assert np.all(np.diff(planned) == 100 * 1_000_000)
        assert rig.scheduler.statistics.slice("publish").count == MILLION // 100
        assert rig.scheduler.statistics.slice("publish").missed_ticks == 0


async def test_virtual_time_lets_others_have_their_turn():
    turns = 0

    async def other():
        nonlocal turns
        while True:
            turns += 1
            await asyncio.sleep(0)

    async with running(counting_step, backend="virtual", paused=True) as rig:
        task = asyncio.create_task(other())
        await rig.scheduler.advance(10_000)
        task.cancel()
    assert turns >= 10_000 // 20  # one turn per communication slice at least


async def test_inputs_are_latched_while_paused_and_a_restore_moves_the_tick():
    async with running(counting_step, backend="virtual", paused=True) as rig:
        await rig.scheduler.advance(30)
        before = int(rig.words[LATCHES])
        rig.words[JUMP_TO] = 500
        await until(lambda: rig.scheduler.tick == 500)
        assert rig.words[LATCHES] > before
        assert rig.words[0] == 30  # no tick was run for it
        await rig.scheduler.advance(1)
        assert rig.words[1] == 4  # tick 500 is a multiple of 10: sensors ran
        assert rig.scheduler.tick == 501
        assert rig.scheduler.ticks_done == 31


async def test_lockstep_alternates_and_ends_when_told():
    seen = []

    async def exchange(tick):
        seen.append(tick)
        return len(seen) < 5

    async with running(counting_step, backend="virtual", paused=True) as rig:
        await rig.scheduler.lockstep(exchange, n_ticks=20, peer="plc", timeout_s=5.0)
        assert seen == [20, 40, 60, 80, 100]
        assert rig.words[0] == 100


async def test_lockstep_names_the_silent_peer():
    async def exchange(tick):
        if tick == 40:
            await asyncio.Event().wait()
        return True

    async with running(counting_step, backend="virtual", paused=True) as rig:
        with pytest.raises(
            PeerSilentError, match=r"plc has been silent for 0\.05 s, tick 40"
        ):
            await rig.scheduler.lockstep(
                exchange, n_ticks=20, peer="plc", timeout_s=0.05
            )


async def test_a_slice_reports_a_fault_once_and_the_step_is_told():
    async with running(counting_step, backend="virtual", paused=True) as rig:
        rig.words[60] = 12
        await rig.scheduler.advance(50)
        assert (rig.words[FAULTS], rig.words[LAST_FAULT]) == (1, 16 + 7)


async def test_a_failing_callback_stops_nobody():
    problems, ticks = [], []

    def broken(tick, planned):
        raise ArithmeticError("broken on purpose")

    def prepare(rig):
        rig.scheduler.on_slice("publish", broken)
        rig.scheduler.on_slice("publish", lambda tick, planned: ticks.append(tick))

    asyncio.get_running_loop().set_exception_handler(
        lambda loop, c: problems.append(c["message"])
    )
    async with running(
        counting_step, backend="virtual", paused=True, prepare=prepare
    ) as rig:
        await rig.scheduler.advance(60)
    assert ticks == [0, 20, 40]
    assert problems == [
        f"slice 'publish' failed in tick {tick}" for tick in (0, 20, 40)
    ]


async def test_unknown_names_are_refused():
    rig = make(counting_step, backend="virtual")
    with pytest.raises(
        KeyError, match="no communication slice 'plant' \\(publish, supervise\\)"
    ):
        rig.scheduler.on_slice("plant", print)
    with pytest.raises(ValueError, match="one of thread, timerfd, virtual"):
        make(counting_step, backend="timer")
    with pytest.raises(ValueError, match=r"0\.01 to 100, not 0"):
        rig.scheduler.set_speed(0.0)
    with pytest.raises(ValueError, match="1 to"):
        rig.scheduler.step(0)
