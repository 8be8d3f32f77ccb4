"""The limit of a wait: whose cancellation it was that ended it."""

import asyncio
import time

import pytest
import wait_for2

from hilserver.time_limit import AbandonedError, time_limit
from tests.hours.clock import Clock
from tests.hours.loop import VirtualLoop


async def answered_as_the_time_ends():
    """Time-out and answer in one turn of the loop: `wait_for2` raises a subclass."""
    loop = asyncio.get_running_loop()
    answer = loop.create_future()
    async with time_limit(0):
        loop.call_soon(answer.set_result, 1)
        await wait_for2.wait_for(answer, 2)


async def test_the_time_is_up_also_if_the_answer_comes_in_the_same_turn_of_the_loop():
    with pytest.raises(TimeoutError):
        await answered_as_the_time_ends()


async def test_a_library_that_cancels_its_own_future_does_not_end_our_task():
    async with asyncio.timeout(5):
        answer = asyncio.get_running_loop().create_future()
        asyncio.get_running_loop().call_soon(answer.cancel)
        with pytest.raises(AbandonedError):
            async with time_limit(2):
                await answer


@pytest.mark.parametrize("limit_s", [None, 60])
async def test_a_cancellation_of_the_task_passes_through(limit_s):
    async def waits():
        async with time_limit(limit_s):
            await asyncio.Event().wait()

    task = asyncio.ensure_future(waits())
    await asyncio.sleep(0)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert task.cancelled()


async def test_the_outer_limit_ends_the_inner_wait():
    async def waits(limit_s, work):
        async with time_limit(limit_s):
            await work

    with pytest.raises(TimeoutError):
        await waits(0, waits(60, asyncio.Event().wait()))


async def test_no_limit_reached_no_error():
    async with time_limit(60):
        await asyncio.sleep(0)


async def answer_after(seconds, *, blocked_s):
    """Answer after so many seconds of a loop that stands for some time at first."""
    time.sleep(blocked_s)  # noqa: ASYNC251 - the quota of a control group looks like that
    await asyncio.sleep(seconds)


async def test_time_that_our_own_loop_loses_does_not_count_if_the_limit_is_told_so():
    with pytest.raises(TimeoutError):
        async with time_limit(0.2):
            await answer_after(0.1, blocked_s=0.3)
    async with time_limit(0.2, at_most_s=5.0):
        await answer_after(0.1, blocked_s=0.3)


async def test_a_limit_that_is_prolonged_still_ends():
    with pytest.raises(TimeoutError):
        async with time_limit(0.05, at_most_s=5.0):
            await asyncio.sleep(4.0)
    with pytest.raises(TimeoutError):
        async with time_limit(0.1, at_most_s=0.2):
            await answer_after(4.0, blocked_s=0.3)


@pytest.mark.parametrize("stands_s", [0.02, 0.3, 20.0])
def test_the_loop_may_stand_still_just_before_the_time_is_up(stands_s):
    """Before, the limit ended the wait first, and what prolongs it failed where nobody saw it."""
    loop = VirtualLoop(Clock())

    async def waits():
        async with time_limit(0.12, at_most_s=60.0):
            await asyncio.sleep(0.11)
            loop.stand_still(stands_s)
            await asyncio.sleep(0.005)

    try:
        if stands_s < 0.05:  # the computer's ordinary delay is part of the limit
            with pytest.raises(TimeoutError):
                loop.run_until_complete(waits())
        else:
            loop.run_until_complete(waits())
        loop.run_until_complete(asyncio.sleep(1.0))
        assert not loop.errors
    finally:
        loop.close()
