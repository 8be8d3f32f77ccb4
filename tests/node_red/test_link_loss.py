"""A peer that is killed, or falls into a black hole: safe in time, back in time, no growth."""

import asyncio
import gc
import time

import pytest

from hilserver.controller.nodes import demo_peer
from tests.io.opcua_client.conftest import Harness, make_harness, wait_until
from tests.node_red.black_hole import THEIRS, peer_network
from tests.node_red.node_red import shipped_flow
from tests.node_red.resources import Holdings

pytestmark = [pytest.mark.node_red, pytest.mark.timeout(300)]

STALE_S = 0.5
NOTICE_S = 0.3
"""Scheduling and the shared machine; the stale time itself is exact."""

BACK_S = 2.0


async def seconds_until(condition, limit_s: float) -> float:
    started = time.monotonic()
    await wait_until(condition, limit_s)
    return time.monotonic() - started


async def assert_lost_in_time(harness: Harness, losses: int) -> None:
    took = await seconds_until(lambda: len(harness.stale) == losses, 5)
    assert took <= STALE_S + NOTICE_S
    assert harness.stale[-1] == ("iot2050", "ramp")
    assert harness.status.stale


async def assert_back_in_time(harness: Harness) -> None:
    assert await seconds_until(lambda: not harness.status.stale, 15) <= BACK_S


@pytest.mark.parametrize("rounds", [5, pytest.param(20, marks=pytest.mark.long)])
async def test_killed_and_restarted(node_red, rounds):
    peer = node_red(shipped_flow())
    harness = make_harness(demo_peer(peer.endpoint, name="iot2050"))
    await harness.link.start()  # before the peer: any start order
    held, tasks = [], []
    try:
        for number in range(1, rounds + 1):
            await peer.start()
            await assert_back_in_time(harness)
            await asyncio.sleep(0.5)
            gc.collect()
            held.append(Holdings.of())
            tasks.append(len(asyncio.all_tasks()))
            await peer.kill()
            await assert_lost_in_time(harness, number)
    finally:
        await harness.link.stop()
    assert harness.status.reconnects == rounds - 1
    assert len(harness.restored) == rounds - 1
    assert max(tasks) == min(tasks)
    assert max(h.sockets for h in held) == min(h.sockets for h in held)
    assert max(h.files for h in held) == min(h.files for h in held)
    # The second round, when everything has been loaded once, against the last.
    assert held[-1].memory_kib - held[1].memory_kib < 4 * 1024


@pytest.mark.network
async def test_black_hole(node_red):
    with peer_network() as network:
        peer = node_red(shipped_flow(), host=THEIRS, prefix=network.prefix)
        await peer.start()
        harness = make_harness(demo_peer(peer.endpoint, name="iot2050"))
        await harness.link.start()
        try:
            await wait_until(lambda: not harness.status.stale)
            tasks, before = len(asyncio.all_tasks()), Holdings.of()
            for number, hole_s in enumerate((3.0, 8.0), start=1):
                network.swallow()
                await assert_lost_in_time(harness, number)
                await asyncio.sleep(hole_s)
                network.heal()
                await assert_back_in_time(harness)
            await asyncio.sleep(0.5)
            assert harness.status.reconnects >= 1
            assert len(asyncio.all_tasks()) == tasks
            assert Holdings.of().sockets == before.sockets
        finally:
            await harness.link.stop()
            await peer.kill()
