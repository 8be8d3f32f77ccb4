"""The loop and the network of simulated hours keep what a computer promises, and no more."""

import asyncio
import contextlib
import itertools

import pytest

from tests.hours.clock import Clock
from tests.hours.loop import VirtualLoop
from tests.hours.network import KERNEL_BYTES, Network


@contextlib.contextmanager
def world(seed=0):
    loop = VirtualLoop(Clock())
    loop.chance.seed(seed)
    try:
        yield loop, Network(loop)
    finally:
        loop.close()


class End(asyncio.Protocol):
    """Remembers what it is told."""

    def __init__(self):
        self.data, self.lost, self.paused = b"", [], 0

    def data_received(self, data):
        self.data += data

    def connection_lost(self, error):
        self.lost.append(error)

    def pause_writing(self):
        self.paused += 1

    def resume_writing(self):
        self.paused -= 1


async def connected(network):
    """Return both transports of a connection."""
    network.listen(End, "127.0.0.1", 1)
    here, _ = await network.connect(End, "127.0.0.1", 1)
    return here, here.other


def test_an_idle_hour_takes_no_time():
    with world() as (loop, _):
        begun_s, turns = loop.time(), loop.turns
        loop.run_until_complete(asyncio.sleep(3600))
        assert loop.time() - begun_s == pytest.approx(3600, abs=1)
        assert loop.turns - turns < 10


def test_time_passes_for_the_plant_while_the_loop_stands_still():
    with world() as (loop, _):
        passed = [loop.clock.now_ns]
        loop.clock.on_advance = passed.append
        loop.call_soon(loop.stand_still, 0.5)
        loop.run_until_complete(asyncio.sleep(0.1))
        assert max(b - a for a, b in itertools.pairwise(passed)) >= 0.5e9


def order_of_arrivals(seed):
    with world(seed) as (loop, _):
        found = []
        for name in "abcdef":
            loop.arrive(loop.clock.now_ns + 10, lambda name=name: found.append(name))
        loop.run_until_complete(asyncio.sleep(0.1))
        return "".join(found)


def test_the_order_of_what_arrives_together_is_drawn():
    assert len({order_of_arrivals(seed) for seed in range(20)}) > 5
    assert order_of_arrivals(7) == order_of_arrivals(7)


@pytest.mark.parametrize("seed", range(5))
def test_a_stream_keeps_its_order_in_whatever_pieces(seed):
    with world(seed) as (loop, network):

        async def talk():
            here, there = await connected(network)
            for number in range(2000):
                here.write(number.to_bytes(4, "big"))
            await asyncio.sleep(5)
            return there.protocol.data

        expected = b"".join(number.to_bytes(4, "big") for number in range(2000))
        assert loop.run_until_complete(talk()) == expected


def test_a_reader_who_does_not_read_holds_up_its_writer():
    with world() as (loop, network):

        async def talk():
            here, there = await connected(network)
            there.pause_reading()
            here.write(bytes(KERNEL_BYTES + 100_000))
            await asyncio.sleep(1)
            assert (here.protocol.paused, there.protocol.data) == (1, b"")
            there.resume_reading()
            await asyncio.sleep(1)
            assert (here.protocol.paused, len(there.protocol.data)) == (
                0,
                KERNEL_BYTES + 100_000,
            )

        loop.run_until_complete(talk())


def test_a_cut_tells_both_ends_and_a_computer_that_is_gone_tells_none():
    with world() as (loop, network):

        async def talk():
            here, there = await connected(network)
            network.cut(here)
            await asyncio.sleep(1)
            told = [here.protocol.lost, there.protocol.lost]
            assert [len(ends) for ends in told] == [1, 1]
            del network.listening[1]
            here, there = await connected(network)
            network.vanish(here)
            there.write(b"is anybody there?")
            await asyncio.sleep(60)
            assert (there.protocol.lost, here.protocol.data) == ([], b"")

        loop.run_until_complete(talk())


def test_what_a_frozen_program_was_sent_arrives_when_it_goes_on():
    with world() as (loop, network):

        async def talk():
            here, there = await connected(network)
            network.freeze(there)
            here.write(b"hello")
            await asyncio.sleep(10)
            assert there.protocol.data == b""
            network.thaw(there)
            await asyncio.sleep(1)
            assert there.protocol.data == b"hello"

        loop.run_until_complete(talk())
