"""The daemon and a peer that is killed, or falls into a black hole: safe in time, back in time."""

import asyncio
import contextlib
import gc
import time
from collections.abc import AsyncIterator, Callable

import pytest

from hilserver.config.peers import PeerConfig
from hilserver.config.root import Config
from hilserver.controller.nodes import demo_peer
from hilserver.daemon.assembly import assemble_config
from hilserver.daemon.daemon import Daemon
from hilserver.errors import ControlRefused
from hilserver.signals import State
from tests.io.opcua_client.conftest import wait_until
from tests.node_red.black_hole import THEIRS, peer_network
from tests.node_red.node_red import shipped_flow
from tests.node_red.resources import Holdings

pytestmark = pytest.mark.node_red

STALE_S = 0.5
NOTICE_S = 0.3
"""What a busy machine may add; the stale time itself is exact."""

BACK_S = 2.0


@contextlib.asynccontextmanager
async def running_daemon(peer: PeerConfig) -> AsyncIterator[Daemon]:
    config = Config.model_validate(
        {
            "image": {"name": "auto"},
            "opcua": {"enabled": False},
            "metrics": {"enabled": False},
            "scheduler": {
                "limits": {"single_overrun_ms": None, "consecutive_overruns": None}
            },
            "peers": [peer.model_dump(mode="json")],
        }
    )
    async with Daemon(assemble_config(config)) as daemon:
        yield daemon


def speed_rpm(daemon: Daemon) -> float:
    frame = daemon.image.latest()
    assert frame is not None
    return float(frame.values[daemon.table.slot("wheel.fl.speed_rpm")])


async def seconds_until(condition: Callable[[], bool]) -> float:
    started = time.monotonic()
    await wait_until(condition)
    return time.monotonic() - started


async def seconds_to_safe(daemon: Daemon) -> float:
    """Wait until the robot stands in the safe state; return how long that state took."""
    took_s = await seconds_until(lambda: daemon.control.state is State.SAFE)
    await wait_until(lambda: abs(speed_rpm(daemon)) < 0.5)
    return took_s


async def seconds_to_return(daemon: Daemon) -> float:
    """Wait until the peer drives again; return how long it took to be fresh."""
    took_s = await seconds_until(lambda: not daemon.parts_of("peers")[0].status.stale)

    def drives() -> bool:
        if daemon.control.state is State.SAFE:
            with contextlib.suppress(ControlRefused):  # late once more
                daemon.control.reset()
                daemon.control.start()
        return daemon.control.state is State.RUNNING and speed_rpm(daemon) > 5

    await wait_until(drives)
    return took_s


@pytest.mark.parametrize("rounds", [3, pytest.param(20, marks=pytest.mark.long)])
async def test_killed_and_restarted(node_red, rounds):
    peer = node_red(shipped_flow())
    held, back_s, safe_s, tasks = [], [], [], 0
    # The daemon first and the peer later: any start order.
    async with running_daemon(demo_peer(peer.endpoint, name="iot2050")) as daemon:
        for _ in range(rounds):
            await peer.start()
            back_s.append(await seconds_to_return(daemon))
            gc.collect()
            held.append(Holdings.of())
            tasks = tasks or len(asyncio.all_tasks())
            await wait_until(lambda: len(asyncio.all_tasks()) <= tasks)  # noqa: B023
            await peer.kill()
            safe_s.append(await seconds_to_safe(daemon))
        status = daemon.parts_of("peers")[0].status
        assert status.reconnects >= rounds - 1
    # A busy computer may hold up any round, and not all of them.
    assert min(back_s) <= BACK_S
    assert min(safe_s) <= STALE_S + NOTICE_S
    assert max(h.sockets for h in held) == min(h.sockets for h in held)
    assert max(h.files for h in held) == min(h.files for h in held)
    # From the second round on everything has been loaded once.
    assert held[-1].memory_kib - held[1].memory_kib < 4 * 1024


@pytest.mark.network
async def test_black_hole(node_red):
    with peer_network() as network:
        peer = node_red(shipped_flow(), host=THEIRS, prefix=network.prefix)
        await peer.start()
        async with running_daemon(demo_peer(peer.endpoint, name="iot2050")) as daemon:
            await seconds_to_return(daemon)
            gc.collect()
            tasks, before = len(asyncio.all_tasks()), Holdings.of()
            # Shorter and longer than the link's own patience.
            for hole_s in (1.0, 7.0):
                network.swallow()
                await seconds_to_safe(daemon)
                await asyncio.sleep(hole_s)
                network.heal()
                await seconds_to_return(daemon)
            assert daemon.parts_of("peers")[0].status.reconnects >= 1
            await wait_until(lambda: len(asyncio.all_tasks()) <= tasks)
            await wait_until(lambda: Holdings.of().sockets <= before.sockets)
        await peer.kill()
