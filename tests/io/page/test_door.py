"""Connections: half-open ones yield, live sockets and fresh requests stay."""

import asyncio
import socket
import ssl

import pytest
import uvloop

from hilserver.io.page import door as door_module
from hilserver.io.page.door import YIELDS_AFTER_S, PageDoor, Use
from hilserver.io.page.listening import listen, tls_context
from tests.page.test_users import make_tls

MOST = 8


class Transport:
    """As much of one as a place needs."""

    def __init__(self, address):
        self.address, self.is_open = address, True

    def get_extra_info(self, _name):
        return (self.address, 1)

    def get_write_buffer_size(self):
        return 0

    def abort(self):
        self.is_open = False


@pytest.fixture
async def come_in():
    door, made = PageDoor(most=MOST), []

    def come_in(address, use=Use.WAITS, age_s=0.0):
        place, transport = door.place(address), Transport(address)
        if place is None:
            return None
        place.connection_made(transport)
        place.uses(use)
        place.since_s -= age_s
        made.append(place)
        return transport

    yield come_in
    for place in made:
        place.connection_lost(None)
    assert not door._places


async def test_of_the_largest_crowd_the_longest_waiting_yields(come_in):
    alone = come_in("192.0.2.9", age_s=4.0)
    crowd = [come_in("192.0.2.1", age_s=i * 0.1) for i in range(MOST - 1)]
    newcomer = come_in("192.0.2.5")
    assert newcomer.is_open
    assert alone.is_open
    assert [t for t in crowd if not t.is_open] == [crowd[-1]]


async def test_nobody_who_is_served_yields_before_its_time(come_in):
    for _ in range(MOST - 1):
        come_in("192.0.2.1", Use.WORKS)
    come_in("192.0.2.1", Use.LIVE, 10 * YIELDS_AFTER_S)
    assert come_in("192.0.2.5") is None


async def test_a_request_that_never_ends_yields(come_in):
    live = [come_in("192.0.2.1", Use.LIVE, 100.0) for _ in range(MOST - 1)]
    stuck = come_in("192.0.2.1", Use.WORKS, 2 * YIELDS_AFTER_S)
    assert come_in("192.0.2.5").is_open
    assert not stuck.is_open
    assert all(transport.is_open for transport in live)


async def test_who_sends_no_whole_request_is_gone_in_time(monkeypatch):
    monkeypatch.setattr(door_module, "HEAD_S", 0.01)
    place, transport = PageDoor(most=MOST).place("192.0.2.1"), Transport("192.0.2.1")
    place.connection_made(transport)
    async with asyncio.timeout(60):
        while transport.is_open:  # noqa: ASYNC110 - a transport tells nobody
            await asyncio.sleep(0.01)


class Echo(asyncio.Protocol):
    def connection_made(self, transport):
        self.transport = transport

    def data_received(self, data):
        self.transport.write(data)


def says_hello(port):
    trusting = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    trusting.check_hostname, trusting.verify_mode = False, ssl.CERT_NONE
    with (
        socket.create_connection(("127.0.0.1", port), timeout=60) as plain,
        trusting.wrap_socket(plain) as secured,
    ):
        secured.sendall(b"hello")
        return secured.recv(5)


@pytest.mark.parametrize("make_loop", [uvloop.new_event_loop, asyncio.new_event_loop])
def test_whoever_begins_with_encryption_at_once_is_understood(tmp_path, make_loop):
    """The first words may be there before the connection is accepted."""
    make_tls(tmp_path)
    tls = tls_context(tmp_path / "page.pem", tmp_path / "page.key")

    async def greet():
        listener, door = listen("127.0.0.1", 0), PageDoor(tls)
        door.behind = Echo
        port = listener.getsockname()[1]
        greetings = [asyncio.to_thread(says_hello, port) for _ in range(60)]
        letting_in = asyncio.create_task(door.let_in(listener))
        try:
            return await asyncio.gather(*greetings)
        finally:
            letting_in.cancel()
            await asyncio.gather(letting_in, return_exceptions=True)
            listener.close()

    with asyncio.Runner(loop_factory=make_loop) as runner:
        assert set(runner.run(greet())) == {b"hello"}


async def test_whoever_never_says_hello_gives_its_place_back(tmp_path, monkeypatch):
    monkeypatch.setattr(door_module, "HEAD_S", 0.2)
    make_tls(tmp_path)
    tls = tls_context(tmp_path / "page.pem", tmp_path / "page.key")
    listener, door = listen("127.0.0.1", 0), PageDoor(tls)
    letting_in = asyncio.create_task(door.let_in(listener))
    reader, writer = await asyncio.open_connection(*listener.getsockname())
    async with asyncio.timeout(60):
        assert await reader.read() == b""
    assert not door._places
    writer.close()
    letting_in.cancel()
    await asyncio.gather(letting_in, return_exceptions=True)
    listener.close()
