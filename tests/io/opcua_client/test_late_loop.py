"""An event loop that is held up calls nobody silent for what it has not read yet."""

import asyncio
import threading
import time
from contextlib import contextmanager
from datetime import UTC, datetime

import pytest
import uvloop

from hilserver.controller.nodes import SEQUENCE, SETPOINTS, node_id
from hilserver.controller.server import ControllerServer
from tests.io.opcua_client.conftest import make_harness, peer_config, wait_until

STALE_AFTER_S = 1.0
HELD_UP_S = 1.2
OFFERED_S = 0.02


class SpeakingPeer:
    """A controller in a thread of its own, so that what holds us up does not hold it up.

    Attributes
    ----------
    offered_ns : int
        CLOCK_MONOTONIC of the newest set-points.
    """

    def __init__(self):
        self.is_silent = False
        self.offered_ns = 0
        self.server = ControllerServer("opc.tcp://127.0.0.1:0/UA/NodeRedAgv")
        self.listens = threading.Event()
        self.ends = threading.Event()

    def run(self):
        asyncio.run(self._serve())

    async def _serve(self):
        async with self.server:
            self.listens.set()
            sequence = 0
            while not self.ends.is_set():
                if not self.is_silent:
                    sequence += 1
                    self.offered_ns = time.monotonic_ns()
                    values = {"rpm_set_FL": sequence % 50.0, SEQUENCE: sequence}
                    await self.server.offer(values, datetime.now(UTC))
                await asyncio.sleep(OFFERED_S)


@contextmanager
def speaking_peer():
    peer = SpeakingPeer()
    thread = threading.Thread(target=peer.run)
    thread.start()
    try:
        assert peer.listens.wait(120)
        yield peer
    finally:
        peer.ends.set()
        thread.join(120)


def harness_of(peer, mode):
    config = peer_config(
        0,
        endpoint=peer.server.endpoint,
        mode=mode,
        publishing_ms=20,
        stale_after_ms=STALE_AFTER_S * 1e3,
        sequence_node=node_id(SEQUENCE),
        read={node_id("rpm_set_FL"): SETPOINTS["rpm_set_FL"]},
    )
    return make_harness(config)


@pytest.mark.parametrize("mode", ["subscribe", "poll"])
@pytest.mark.parametrize("loop", ["asyncio", "uvloop"])
def test_a_peer_that_speaks_is_not_silent_while_we_are_held_up(loop, mode):
    async def scene(peer):
        harness = harness_of(peer, mode)
        await harness.link.start()
        try:
            await wait_until(lambda: not harness.status.stale)
            for _ in range(3):
                heard = len(harness.gate.groups)
                time.sleep(HELD_UP_S)  # noqa: ASYNC251 - the event loop is what is held up
                await wait_until(lambda heard=heard: len(harness.gate.groups) > heard)
                assert harness.stale == []
            peer.is_silent = True
            await wait_until(lambda: harness.stale == [("iot2050", "ramp")])
            assert time.monotonic_ns() - peer.offered_ns > STALE_AFTER_S * 1e9
        finally:
            await harness.link.stop()

    factory = uvloop.new_event_loop if loop == "uvloop" else asyncio.new_event_loop
    with speaking_peer() as peer, asyncio.Runner(loop_factory=factory) as runner:
        runner.run(scene(peer))
