"""Sockets of browsers: one that takes nothing holds up no other, however much there is to show."""

import asyncio
import itertools
import json
import secrets
import socket
from types import SimpleNamespace

import aiohttp
import pytest
from aiohttp import web

from hilserver.image.board import REGION, WORDS, Board
from hilserver.io.page import live as live_module
from hilserver.io.page.browsers import Browser
from hilserver.io.page.door import PageDoor
from hilserver.io.page.driving import PageDriving
from hilserver.io.page.live import Live
from tests.fakes import make_image

WITHIN_S, PLACES, HELD_BYTES = 120, 4, 8192
LARGE = secrets.token_hex(45_000)
"""A third of what the board may hold: faults, events and peers of a large robot."""


@pytest.fixture
async def page(monkeypatch):
    """A server whose board is large and new all the time; returns its sockets and its address."""
    monkeypatch.setattr(live_module, "BOARD_EVERY_S", 0.0)
    image = make_image(fixed={REGION: WORDS})
    assert Board(image).show({"large": LARGE})
    live = Live(
        image,
        {},
        PageDriving(300.0),
        rate_hz=200.0,
        max_clients=PLACES,
        jobs=SimpleNamespace(view=list),
        stopping=None,
        door=PageDoor(),
    )
    browser = Browser(hand=None)
    application = web.Application()

    async def serve(request):
        return await live.serve(request, browser)

    application.add_routes([web.get("/", serve)])
    runner = web.AppRunner(application)
    await runner.setup()
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, HELD_BYTES)
        await web.SockSite(runner, listener.dup()).start()
    frames = asyncio.create_task(live.run())
    yield SimpleNamespace(live=live, browser=browser, port=runner.addresses[0][1])
    frames.cancel()
    await live.close()
    await runner.cleanup()
    image.close()


async def entered(session, page):
    ws = await session.ws_connect(f"http://127.0.0.1:{page.port}/", max_msg_size=0)
    await ws.send_json({"ticket": page.browser.new_ticket()})
    return ws


async def raw_watcher(page):
    """A browser's socket by hand: it takes as many bytes as it likes."""
    made, loop = socket.socket(), asyncio.get_running_loop()
    made.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, HELD_BYTES)
    made.setblocking(False)
    await loop.sock_connect(made, ("127.0.0.1", page.port))
    head = "GET / HTTP/1.1\r\nHost: x\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
    head += "Sec-WebSocket-Version: 13\r\nSec-WebSocket-Key: AAAAAAAAAAAAAAAAAAAAAA==\r\n\r\n"
    await loop.sock_sendall(made, head.encode())
    text = json.dumps({"ticket": page.browser.new_ticket()}).encode()
    await loop.sock_sendall(made, bytes([0x81, 0x80 | len(text), 0, 0, 0, 0]) + text)
    return made


async def test_who_reads_slowly_or_not_at_all_holds_up_nobody(page):
    loop = asyncio.get_running_loop()
    async with asyncio.timeout(WITHIN_S), aiohttp.ClientSession() as session:
        driver = await entered(session, page)
        assert (await driver.receive_json())["type"] == "welcome"
        with await raw_watcher(page) as watcher:
            while not (slow := page.live.find(2)) or not slow.lost:
                await driver.receive()
            for _ in range(5 * len(LARGE) // HELD_BYTES):
                await loop.sock_recv(watcher, HELD_BYTES)
                for _ in range(2):
                    assert json.loads(await driver.receive_str())["type"] == "board"


async def test_who_takes_nothing_for_long_gives_the_place_back(
    page, monkeypatch, caplog
):
    # Time passes by looks, so that a pause of a busy computer is no time: the driver stays.
    looks = itertools.count()
    clock = SimpleNamespace(monotonic=lambda: next(looks))
    monkeypatch.setattr(live_module, "time", clock)
    monkeypatch.setattr(live_module, "UNREAD_S", 100)
    async with asyncio.timeout(WITHIN_S), aiohttp.ClientSession() as session:
        driver = await entered(session, page)
        with await raw_watcher(page):
            while not page.live.find(2):
                await driver.receive()
            while page.live.find(2):
                await driver.receive()
    assert [r.levelname for r in caplog.records if "takes nothing" in r.message] == [
        "WARNING"
    ]


async def test_however_many_greet_at_once_so_many_come_in_as_there_are_places(page):
    n = 2 * PLACES
    async with asyncio.timeout(WITHIN_S), aiohttp.ClientSession() as session:
        url = f"http://127.0.0.1:{page.port}/"
        waiting = [await session.ws_connect(url, max_msg_size=0) for _ in range(n)]
        for ws in waiting:
            await ws.send_json({"ticket": page.browser.new_ticket()})
        first = [await ws.receive() for ws in waiting]
    assert [m.type for m in first].count(aiohttp.WSMsgType.TEXT) == PLACES
    refused = [m.data for m in first if m.type is aiohttp.WSMsgType.CLOSE]
    assert refused == [aiohttp.WSCloseCode.TRY_AGAIN_LATER] * (n - PLACES)
