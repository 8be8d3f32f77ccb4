"""Connections: half-open ones yield, live sockets and fresh requests stay."""

import asyncio

import pytest

from hilserver.io.page import door as door_module
from hilserver.io.page.door import YIELDS_AFTER_S, Door, Use

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
    door, made = Door(most=MOST), []

    def come_in(address, use=Use.WAITS, age_s=0.0):
        place, transport = door(), Transport(address)
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
    assert not come_in("192.0.2.5").is_open


async def test_a_request_that_never_ends_yields(come_in):
    live = [come_in("192.0.2.1", Use.LIVE, 100.0) for _ in range(MOST - 1)]
    stuck = come_in("192.0.2.1", Use.WORKS, 2 * YIELDS_AFTER_S)
    assert come_in("192.0.2.5").is_open
    assert not stuck.is_open
    assert all(transport.is_open for transport in live)


async def test_who_sends_no_whole_request_is_gone_in_time(monkeypatch):
    monkeypatch.setattr(door_module, "HEAD_S", 0.01)
    place, transport = Door(most=MOST)(), Transport("192.0.2.1")
    place.connection_made(transport)
    async with asyncio.timeout(60):
        while transport.is_open:  # noqa: ASYNC110 - a transport tells nobody
            await asyncio.sleep(0.01)
