"""Pause, step, resume, speed, stop: the same in every back end."""

import asyncio
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from hilserver.scheduler import OverrunPolicy, Scheduler, Slice, StopReason
from hilserver.scheduler.exchange import ACKNOWLEDGED, COMMAND, FREE_RUN, Exchange
from tests.scheduler.kernels import JUMP_TO, LATCHES, PUBLISHES, SHOWN, counting_step
from tests.scheduler.rig import make, running, until

BACKENDS = ("thread", "timerfd", "virtual")


def count_descriptors():
    return len(list(Path("/proc/self/fd").iterdir()))


@pytest.mark.parametrize("backend", BACKENDS)
async def test_a_step_runs_exactly_n_ticks_however_it_is_asked(backend):
    async with running(counting_step, backend=backend, paused=True) as rig:
        scheduler = rig.scheduler
        await scheduler.advance(1)
        assert (scheduler.tick, scheduler.paused) == (1, True)
        scheduler.step(3)
        scheduler.step(4)  # adds up, even if the first is under way
        await scheduler.wait_paused()
        assert scheduler.tick == 8
        scheduler.resume()
        await until(lambda: scheduler.tick > 20)
        assert not scheduler.paused
        scheduler.step(5)  # from a free run: five more, then stand
        await scheduler.wait_paused()
        standing = scheduler.tick
        latched = int(rig.words[LATCHES])
        await until(lambda: rig.words[LATCHES] > latched + 3)  # inputs still drain
        assert scheduler.tick == standing == rig.words[PUBLISHES]


@pytest.mark.parametrize("backend", BACKENDS)
async def test_pause_ends_a_step_and_resume_voids_it(backend):
    async with running(counting_step, backend=backend, paused=True) as rig:
        rig.scheduler.step(10**9)
        await until(lambda: rig.scheduler.tick > 5)
        rig.scheduler.pause()
        await rig.scheduler.wait_paused()
        standing = rig.scheduler.tick
        await rig.scheduler.advance(2)
        assert rig.scheduler.tick == standing + 2
        assert rig.scheduler.statistics.tick.missed_ticks == 0 or backend != "virtual"


@pytest.mark.parametrize("backend", BACKENDS)
async def test_what_is_restored_while_standing_is_shown_once(backend):
    async with running(counting_step, backend=backend, paused=True) as rig:
        await rig.scheduler.advance(3)
        shown = int(rig.words[PUBLISHES])
        rig.words[JUMP_TO] = 500
        await until(lambda: rig.scheduler.tick == 500)
        latched = int(rig.words[LATCHES])
        await until(lambda: rig.words[LATCHES] > latched + 3)
        assert rig.words[PUBLISHES] == shown + 1
        assert rig.words[SHOWN] == 499, "the newest tick that the restored state knows"


async def test_words_of_a_step_need_no_second_word():
    exchange = Exchange(1000, [])
    assert exchange.get(COMMAND) == FREE_RUN
    assert not exchange.standing
    exchange.pause()
    first = exchange.get(COMMAND)
    exchange.control[ACKNOWLEDGED] = first
    assert exchange.standing
    exchange.step(2)
    assert exchange.get(COMMAND) == first + 2
    # an old acknowledgement does not count for the new command
    assert not exchange.standing
    exchange.pause()
    assert exchange.get(COMMAND) >> 32 == (first >> 32) + 1


@pytest.mark.parametrize("backend", ["thread", "timerfd"])
async def test_speed_scales_pacing_and_not_simulated_time(backend):
    async with running(counting_step, backend=backend, warm_up_ticks=0) as rig:
        rig.scheduler.set_speed(4.0)
        assert rig.scheduler.speed == 4.0
        await until(lambda: rig.scheduler.tick > 50)
        rig.scheduler.statistics.reset()
        await until(lambda: rig.scheduler.statistics.slice("plant").count > 400)
        assert rig.scheduler.statistics.tick.real_time_factor_total > 1.5


@pytest.mark.parametrize("backend", BACKENDS)
async def test_stop_gives_everything_back(backend):
    async with running(counting_step, backend=backend):
        pass  # whatever is opened once and for all
    before, tasks = count_descriptors(), len(asyncio.all_tasks())
    for _ in range(3):
        rig = make(counting_step, backend=backend)
        await rig.scheduler.start()
        await until(lambda rig=rig: rig.scheduler.tick > 3)
        await rig.scheduler.stop()
        await rig.scheduler.stop()
        assert await rig.scheduler.finished is StopReason.STOPPED
        end = rig.scheduler.tick
        await asyncio.sleep(0.01)
        assert rig.scheduler.tick == end
    assert count_descriptors() == before
    assert len(asyncio.all_tasks()) == tasks


async def test_what_compiled_code_would_refuse_is_refused_at_once():
    with pytest.raises(TypeError, match="compiled with kernel"):
        make(lambda *_: 0)
    with pytest.raises(TypeError, match="values must be a flat contiguous float64"):
        Scheduler(
            base_period_ns=1000,
            slices=[Slice("plant", 1, compiled=True)],
            step=counting_step,
            values=np.zeros(4, dtype=np.float32),
            words=np.zeros(4, dtype=np.int64),
        )


async def test_a_start_that_fails_leaves_nothing_behind(monkeypatch):
    before = count_descriptors()
    rig = make(counting_step)

    def refuse(self):
        raise RuntimeError("can't start new thread")

    monkeypatch.setattr(threading.Thread, "start", refuse)
    with pytest.raises(RuntimeError, match="new thread"):
        await rig.scheduler.start()
    await rig.scheduler.stop()
    assert count_descriptors() == before


FORGETFUL = """
import asyncio
from tests.scheduler.kernels import counting_step
from tests.scheduler.rig import make, until

async def main():
    rig = make(counting_step)
    await rig.scheduler.start()
    await until(lambda: rig.scheduler.tick > 20)

asyncio.run(main())  # neither stop() nor anything else
"""


def test_a_program_that_forgets_to_stop_still_ends():
    root = Path(__file__).parents[2]
    done = subprocess.run(
        [sys.executable, "-c", FORGETFUL], cwd=root, timeout=600, check=False
    )
    assert done.returncode == 0


async def test_start_twice_is_refused():
    rig = make(counting_step, backend="virtual")
    await rig.scheduler.start()
    with pytest.raises(RuntimeError, match="can start only once"):
        await rig.scheduler.start()
    await rig.scheduler.stop()


async def test_waiters_are_released_when_the_scheduler_ends():
    rig = make(counting_step, backend="thread", policy=OverrunPolicy("catch_up"))
    await rig.scheduler.start()
    rig.scheduler.step(10**9)
    waiter = asyncio.create_task(rig.scheduler.wait_paused())
    await asyncio.sleep(0.02)
    assert not waiter.done()
    await rig.scheduler.stop()
    async with asyncio.timeout(120):
        await waiter


@pytest.mark.parametrize("backend", BACKENDS)
async def test_communication_slices_run_by_tick_count(backend):
    ticks = []

    def prepare(rig):
        rig.scheduler.on_slice("publish", lambda tick, planned_ns: ticks.append(tick))

    async with running(
        counting_step, backend=backend, paused=True, prepare=prepare
    ) as rig:
        for _ in range(10):
            await rig.scheduler.advance(20)
    assert ticks == list(range(0, 200, 20))
