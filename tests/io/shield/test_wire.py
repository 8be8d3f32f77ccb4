"""What the thread of the line makes of bytes, however late it is."""

import os
import threading
import time

import numpy as np
import pytest

from hilserver.io.shield import words as w
from hilserver.io.shield.framing import stands_alone
from hilserver.io.shield.protocol import BYTE_NS, REQUEST_BYTES, ShieldCommand, request
from hilserver.io.shield.wire import STOOD_NS, _listen, _receive

HOUR_NS, PATIENCE_NS = 3600 * 10**9, 60 * 10**9


class Line:
    """The thread's two steps, without the thread: its pauses are as long as a test wants."""

    def __init__(self):
        self.far, self.near = os.pipe2(os.O_NONBLOCK)
        self.state = np.zeros(w.N_WORDS, dtype=np.int64)
        self.state[w.BYTE], self.state[w.PAUSE] = BYTE_NS, 1
        self.chunk, self.frame = np.zeros((2, REQUEST_BYTES), dtype=np.uint8)
        self.poll, self.scratch = (
            np.zeros(2, dtype=np.int32),
            np.zeros(3, dtype=np.int64),
        )

    def read(self, patience_ns=0):
        """Read once; whatever this thread reads later, it reads after a pause of its own."""
        now_ns = time.monotonic_ns()
        _listen(
            self.far,
            now_ns + patience_ns,
            now_ns,
            self.chunk,
            self.state,
            self.poll,
            self.scratch,
        )
        _receive(self.chunk, self.frame, self.state, -1, self.scratch[2:])


@pytest.fixture
def line():
    line = Line()
    yield line
    os.close(line.far)
    os.close(line.near)


def test_bytes_that_were_waiting_have_come_without_a_pause(line):
    """A driver that opens the line sends XOFF, then a request without its end: 12 bytes wait."""
    odd = request(ShieldCommand.GEAR_RATIO)[:-1] + b"\x07"
    os.write(line.near, b"\x13" + odd)
    line.read()
    first_ns = line.state[w.RX_LAST]
    line.read()
    assert stands_alone(line.state)
    assert line.state[w.SKIPPED] == 1
    assert line.frame.tobytes() == odd
    assert line.state[w.RX_LAST] - first_ns == BYTE_NS


def test_bytes_that_came_later_have_come_after_a_pause(line):
    os.write(line.near, b"\x13" + request(ShieldCommand.ENABLE)[:5])
    line.read()
    line.state[w.RX_LAST] -= HOUR_NS
    os.write(line.near, request(ShieldCommand.ENABLE))
    line.read()  # no more than the half request lacks
    line.read()
    assert line.state[w.REQUESTS] == 1
    assert line.state[w.SKIPPED] == 6


@pytest.mark.parametrize("limit_ms", [1, 100, 1000])
def test_what_has_waited_while_the_thread_stood_is_as_old_as_that(line, limit_ms):
    line.read()
    line.state[w.LIMIT] = limit_ms * 1_000_000
    stood_ns = max(STOOD_NS, line.state[w.LIMIT])
    empty_ns = line.state[w.EMPTY] = line.state[w.EMPTY] - stood_ns
    os.write(line.near, 3 * request(ShieldCommand.ENABLE))
    for _ in range(3):
        line.read()
    stood_ns = time.monotonic_ns()
    os.write(line.near, request(ShieldCommand.ENABLE))
    line.read()
    rows = line.state[w.RING_ROWS :][: 4 * w.WAITING_MOST].reshape(-1, 4)
    came_ns = rows[: line.state[w.RING_HEAD], 3]
    assert len(came_ns) == 4
    assert (came_ns[:3] <= empty_ns + 3 * REQUEST_BYTES * BYTE_NS).all()
    assert came_ns[3] >= stood_ns


def test_a_command_survives_a_standstill_that_is_shorter_than_the_limit(line):
    line.read()
    line.state[w.LIMIT] = HOUR_NS
    line.state[w.EMPTY] -= HOUR_NS // 2
    os.write(line.near, request(ShieldCommand.ENABLE))
    before_ns = time.monotonic_ns()
    line.read()
    assert line.state[w.RX_LAST] >= before_ns


def test_whoever_waits_for_bytes_has_just_seen_that_there_are_none(line):
    """A wait behind another one is no standstill, whatever comes at its end."""
    line.read()
    line.state[w.EMPTY] -= HOUR_NS
    before_ns = line.state[w.RX_LAST] = time.monotonic_ns()
    waiting = threading.Thread(target=line.read, args=(PATIENCE_NS,))
    waiting.start()
    while line.state[w.EMPTY] < before_ns and waiting.is_alive():
        time.sleep(0.001)
    os.write(line.near, request(ShieldCommand.ENABLE))
    waiting.join()
    assert line.state[w.REQUESTS] == 1
    assert line.state[w.RX_LAST] > before_ns + REQUEST_BYTES * BYTE_NS
