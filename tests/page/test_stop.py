"""Stop finds its way: beside a daemon that hangs, and through a page that is crowded."""

import asyncio
import contextlib
import time

import pytest

from tests.page.rig import page_url
from tests.page.test_security import Visitor, aiohttp, visitor  # noqa: F401 - a fixture

HELD_S = 3.0
HALF = b"POST /api/call HTTP/1.1\r\nHost: 127.0.0.1\r\n"


class Watch:
    """Sees when the step obeys: the plant's own command, which no Python writes."""

    def __init__(self, plant):
        self._plant = plant

    @property
    def is_stopped(self):
        return self._plant.value("internal.command") == 2

    async def until(self, *, stopped, within_s=60.0):
        """Wait; return when it was seen [s]."""
        async with asyncio.timeout(within_s):
            while self.is_stopped != stopped:  # noqa: ASYNC110 - the plant tells nobody
                await asyncio.sleep(0.001)
        return time.monotonic()


@pytest.fixture
async def watch(plant, visitor):  # noqa: F811
    await visitor.call("session")
    watch = Watch(plant)
    yield watch
    await visitor.call("Reset")
    await watch.until(stopped=False)


@pytest.fixture
async def crowd(daemon):
    """Hold so many connections, each with the beginning of a request."""
    host, port = page_url(daemon).removeprefix("http://").rstrip("/").split(":")
    writers = []

    async def hold(number):
        for _ in range(number):
            _, writer = await asyncio.open_connection(host, int(port))
            writer.write(HALF)
            writers.append(writer)

    yield hold
    for writer in writers:
        writer.transport.abort()


async def stopped(socket):
    async with asyncio.timeout(60):
        while True:
            message = await socket.receive()
            if message.type is aiohttp.WSMsgType.TEXT and '"stopped"' in message.data:
                return


@pytest.mark.parametrize("way", ["socket", "request"])
async def test_stop_needs_nothing_of_the_daemon_but_its_step(
    visitor,  # noqa: F811
    watch,
    daemon,
    way,
):
    """No Python runs in the daemon meanwhile; before, Stop waited for it and failed."""
    socket = await visitor.live()
    daemon.process.stdin.write(b"%g" % HELD_S)
    daemon.process.stdin.flush()
    await asyncio.sleep(0.3)
    pressed_s = time.monotonic()
    if way == "socket":
        await socket.send_json({"stop": 7})
        await stopped(socket)
    else:
        status, answer = await visitor.call("Stop")
        assert (status, answer["ok"]) == (200, True)
    late_ms = 1e3 * (await watch.until(stopped=True, within_s=HELD_S / 2) - pressed_s)
    print(f"begins after {late_ms:.0f} ms")
    await socket.close()


async def test_256_half_open_requests_do_not_refuse_stop(visitor, watch, crowd):  # noqa: F811
    await crowd(256)
    async with aiohttp.ClientSession(cookie_jar=visitor.session.cookie_jar) as session:
        fresh = Visitor(session, visitor.url)
        fresh.token = visitor.token
        status, _ = await fresh.call("Stop")
    assert status == 200
    await watch.until(stopped=True)


async def test_an_open_socket_stops_beside_600_half_open_requests(
    visitor,  # noqa: F811
    watch,
    crowd,
):
    socket = await visitor.live()
    await crowd(600)
    await socket.send_json({"stop": 1})
    await stopped(socket)
    await watch.until(stopped=True)
    await socket.close()


async def test_all_sockets_taken_do_not_refuse_stop(visitor, watch):  # noqa: F811
    sockets = [await visitor.live() for _ in range(5)]
    assert (await visitor.call("Stop"))[0] == 200
    await watch.until(stopped=True)
    for socket in sockets:
        await socket.close()


async def test_a_head_that_does_not_come_ends_its_connection(daemon):
    host, port = page_url(daemon).removeprefix("http://").rstrip("/").split(":")
    reader, writer = await asyncio.open_connection(host, int(port))
    writer.write(HALF)
    async with asyncio.timeout(60):
        with contextlib.suppress(ConnectionError):
            assert await reader.read() == b""
    writer.close()
