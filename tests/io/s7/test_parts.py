"""Messages never exceed what was agreed, and nothing torn is used, whatever the interleaving."""

import asyncio
import struct

from hypothesis import given, settings
from hypothesis import strategies as st

from hilserver.config.s7 import Endpoint
from hilserver.io.s7 import wire
from hilserver.io.s7.connection import S7Connection, S7Write, parts
from hilserver.io.s7.server import Answers
from hilserver.io.s7.wire import Item

HEADERS = 7
PDU = st.integers(239, 481)


class Memory:
    """A block of plain bytes."""

    def __init__(self, size):
        self.data = bytearray(size)

    def read(self, item, content):
        return bytes(self.data[item.bit // 8 :][: item.size])

    def written(self, item, data):
        self.data[item.bit // 8 : item.bit // 8 + item.size] = data
        return {}


class Wired(S7Connection):
    """A connection whose other end answers at once; no message may be longer than agreed."""

    def __init__(self, pdu_bytes, memory):
        super().__init__(Endpoint("127.0.0.1", 102, 0, 1))
        self._answers = Answers({1: memory}, pdu_bytes, lambda: {1: b""}, lambda *_: {})
        self.pdu_bytes, self.jobs = pdu_bytes, 0

    async def _exchange(self, parameters, data=b""):
        self.jobs += 1
        sent = wire.job(1, parameters, data)[HEADERS:]
        assert len(sent) <= self.pdu_bytes
        back = self._answers.to(wire.taken_apart((0xF0, sent)))[HEADERS:]
        assert len(back) <= self.pdu_bytes
        return wire.taken_apart((0xF0, back))


@given(PDU, st.integers(0, 50), st.integers(1, 1500))
@settings(max_examples=200, deadline=None)
def test_any_length_is_read_and_written_whole_in_the_fewest_messages(pdu, start, size):
    memory = Memory(start + size)
    wired = Wired(pdu, memory)
    content = bytes(i * 11 % 253 for i in range(size))
    asyncio.run(wired.write([S7Write(Item(1, 8 * start, size), content)]))
    assert wired.jobs == -(-size // ((pdu - wire.WRITE_OVERHEAD) // 2 * 2))
    wired.jobs = 0
    assert asyncio.run(wired.read(1, start, size)) == content
    assert wired.jobs == -(-size // ((pdu - wire.READ_OVERHEAD) // 2 * 2))


RUNS = st.lists(
    st.tuples(st.integers(0, 6), st.integers(1, 300)), min_size=1, max_size=30
)


@given(PDU, RUNS)
@settings(max_examples=200, deadline=None)
def test_scattered_runs_arrive_and_what_stands_between_stays(pdu, gaps):
    runs, at = [], 0
    for gap, size in gaps:
        at += gap
        runs.append(S7Write(Item(1, 8 * at, size), bytes([1 + len(runs)]) * size))
        at += size
    memory = Memory(at)
    asyncio.run(Wired(pdu, memory).write(runs))
    expected = bytearray(at)
    for item, data in runs:
        expected[item.bit // 8 : item.bit // 8 + item.size] = data
    assert memory.data == expected


@given(PDU, st.integers(6, 60), st.lists(st.booleans(), max_size=200))
@settings(max_examples=300, deadline=None)
def test_no_torn_block_has_the_same_counter_at_both_ends(pdu, words, turns):
    """Writer and reader take turns, a message each; a block with equal ends is of one cycle."""
    words *= 8
    memory, step = Memory(4 * words), (pdu - wire.READ_OVERHEAD) // 2 * 2
    writing, reading, version = [], b"", 0
    for is_writer in turns:
        if is_writer:
            if not writing:
                version += 1
                block = struct.pack(">I", version) * words
                writing = list(parts([S7Write(Item(1, 0, len(block)), block)], pdu))
            for item, data in writing.pop(0):
                memory.written(item, data)
            continue
        reading += memory.data[len(reading) : len(reading) + step]
        if len(reading) == 4 * words:
            found = struct.unpack(f">{words}I", reading)
            if found[0] == found[-1]:
                assert len(set(found)) == 1
            reading = b""
