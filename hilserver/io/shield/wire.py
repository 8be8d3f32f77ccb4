"""The serial line in compiled code: a thread that reads, answers and keeps the time of the wire.

It never needs the interpreter lock, so a busy event loop delays no response. Bytes of a request
count as received when a line of 115200 baud would have carried them; those of a response are handed
over together when it would have carried the last one, as a UART with a FIFO hands them to its
driver. Bytes that waited while this thread stood still are dated from the start of the standstill.
A response is sent only after the line has carried the one before.
"""

from typing import Any, Final, NamedTuple

import numpy as np
from numba.core import types
from numba.core.types import ExternalFunction, int32, int64, uint64, voidptr
from numba.core.types.containers import NamedTuple as RecordType
from numpy.typing import NDArray

from hilserver.compiled import inlined, kernel, part
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.compiled.histogram import bucket_index
from hilserver.compiled.libc import libc_write, monotonic_ns, ring_doorbell, sleep_until
from hilserver.image.ring import copy_latest
from hilserver.io.shield import words as w
from hilserver.io.shield.answer import answer
from hilserver.io.shield.framing import COMPLETE, feed, stands_alone
from hilserver.io.shield.protocol import REQUEST_BYTES, ShieldCommand

libc_read: Any = ExternalFunction("read", int64(int32, voidptr, uint64))
libc_ppoll: Any = ExternalFunction("ppoll", int32(voidptr, uint64, voidptr, voidptr))

LONGEST_WAIT_NS: Final = 50_000_000  # the thread checks its words at least this often
# a thread that is not held up is never later
STOOD_NS: Final = 3 * LONGEST_WAIT_NS // 2
ABSENT_WAIT_NS: Final = 5_000_000  # how often it checks for a host that opens the line
POLL_IN, POLL_BROKEN = 0x1, 0x8 | 0x10 | 0x20
IMU_RAW: Final = int(ShieldCommand.IMU_RAW)

_WORDS, _BYTES, _VALUES = types.int64[::1], types.uint8[::1], types.float64[::1]


class Memory(NamedTuple):
    """Arrays of the thread of a line."""

    state: NDArray[np.int64]  # see `words`
    slots: NDArray[np.int64]  # see `answer.places`
    chunk: NDArray[np.uint8]  # bytes that were read
    request: NDArray[np.uint8]  # made of them
    out: NDArray[np.uint8]  # the response
    values: NDArray[np.float64]  # of the process image, as `words`
    words: NDArray[np.int64]
    frame: NDArray[np.float64]  # scratch for one frame, as `info`
    info: NDArray[np.int64]
    scratch: NDArray[np.int64]  # two words for libc's times and a 1 for the doorbell
    poll: NDArray[np.int32]  # shape (2,), scratch for ppoll


@part
def _give(
    buffer: Any, flags: int, received_ns: int, state: Any, doorbell: int, one: Any
) -> None:
    """Hand a request to the event loop and queue its response."""
    state[w.REQUESTS] += 1
    command = int(buffer[1])
    if command == IMU_RAW:
        state[w.RAW] = buffer[2] != 0
    head = state[w.RING_HEAD]
    if head - load_acquire(state, w.RING_TAIL) < w.WAITING_MOST:
        row = w.RING_ROWS + 4 * (head & (w.WAITING_MOST - 1))
        payload = 0
        for i in range(8):
            payload |= int(buffer[2 + i]) << (8 * i)
        state[row], state[row + 1] = command, flags
        state[row + 2], state[row + 3] = payload, received_ns
        store_release(state, w.RING_HEAD, head + 1)
        ring_doorbell(doorbell, one)
    else:
        state[w.UNHEARD] += 1
    waiting = state[w.PENDING_HEAD] - state[w.PENDING_TAIL]
    if waiting >= w.PENDING:
        state[w.UNANSWERED] += 1
        return
    row = w.PENDING_ROWS + 2 * (state[w.PENDING_HEAD] % w.PENDING)
    state[row], state[row + 1] = command, received_ns + state[w.DELAY]
    state[w.PENDING_HEAD] += 1


@inlined
def _receive(chunk: Any, frame: Any, state: Any, doorbell: int, one: Any) -> None:
    """Take the bytes that have come in so far."""
    count, byte_ns = state[w.RX_COUNT], state[w.BYTE]
    first_ns = state[w.RX_DUE] - (count - 1) * byte_ns
    after_pause = first_ns - byte_ns - state[w.RX_LAST] >= state[w.PAUSE]
    for i in range(count):
        found = feed(chunk[i], after_pause and i == 0, frame, state)
        if found == COMPLETE:
            _give(frame, 0, first_ns + i * byte_ns, state, doorbell, one)
    state[w.BYTES] += count
    state[w.RX_LAST] = state[w.RX_DUE]
    state[w.RX_COUNT] = 0


@inlined
def _accept_alone(frame: Any, state: Any, doorbell: int, one: Any) -> None:
    """Take a request without its end, after the pause that shows that it stood alone."""
    state[w.FILL] = 0
    state[w.UNTERMINATED] += 1
    _give(frame, w.ALONE, state[w.RX_LAST], state, doorbell, one)


@inlined
def _prepare(
    out: Any, state: Any, slots: Any, values: Any, words: Any, frame: Any, info: Any
) -> None:
    """Write the next response from the newest frame and set when it may be seen."""
    if copy_latest(values, words, frame, info) < 0:
        return
    row = w.PENDING_ROWS + 2 * (state[w.PENDING_TAIL] % w.PENDING)
    state[w.TX_COUNT] = answer(
        out, state[row], state[w.RAW], state[w.CRC], frame, slots
    )
    begins_ns = max(state[row + 1], state[w.TX_LAST])
    state[w.TX_DUE] = begins_ns + state[w.TX_COUNT] * state[w.BYTE]
    state[w.PENDING_TAIL] += 1


@inlined
def _transmit(file: int, out: Any, now_ns: int, state: Any, timespec: Any) -> None:
    """Send a response whose time has come."""
    count = state[w.TX_COUNT]
    sent = max(libc_write(file, out.ctypes, count), 0)
    late_ns = now_ns - state[w.TX_DUE]
    row = w.STAMP_ROWS + 2 * (state[w.RESPONSES] & (w.STAMPS - 1))
    state[row], state[row + 1] = state[w.TX_DUE], now_ns
    state[w.LATE_SUM] += late_ns
    state[w.LATE_MAX] = max(state[w.LATE_MAX], late_ns)
    state[w.LATE_COUNTS + bucket_index(late_ns)] += 1
    state[w.UNREAD] += count - sent
    state[w.TX_COUNT] = 0
    state[w.TX_LAST] = monotonic_ns(timespec)
    store_release(state, w.RESPONSES, state[w.RESPONSES] + 1)


@part
def _wait(file: int, until_ns: int, now_ns: int, poll: Any, timespec: Any) -> int:
    """Wait for bytes or until a time; return what poll saw."""
    poll[0], poll[1] = file, POLL_IN
    wait_ns = max(until_ns - now_ns, 0)
    timespec[0], timespec[1] = wait_ns // 1_000_000_000, wait_ns % 1_000_000_000
    if libc_ppoll(poll.ctypes, 1, timespec.ctypes, 0) <= 0:
        return 0
    return int(poll[1] >> 16)


@part
def _listen(
    file: int,
    until_ns: int,
    now_ns: int,
    chunk: Any,
    state: Any,
    poll: Any,
    timespec: Any,
) -> bool:
    """Wait for bytes and read no more than a request lacks; return whether the line is lost."""
    if not _wait(file, 0, 0, poll, timespec) & POLL_IN:
        state[w.EMPTY] = now_ns
    seen = _wait(file, until_ns, now_ns, poll, timespec)
    state[w.CONNECTED] = (seen & POLL_BROKEN) == 0
    if seen & POLL_IN:
        now_ns = monotonic_ns(timespec)
        missing = REQUEST_BYTES - state[w.FILL] % REQUEST_BYTES
        count = libc_read(file, chunk.ctypes, missing)
        if count > 0:
            # the sender may be gone
            has_stood = 0 < state[w.EMPTY] < now_ns - max(state[w.LIMIT], STOOD_NS)
            begins_ns = max(state[w.EMPTY] if has_stood else now_ns, state[w.RX_LAST])
            if state[
                w.MORE
            ]:  # however late they are read, they arrived after the last ones
                begins_ns = state[w.RX_LAST]
            state[w.RX_COUNT] = count
            state[w.RX_DUE] = begins_ns + count * state[w.BYTE]
            state[w.MORE] = (_wait(file, 0, 0, poll, timespec) & POLL_IN) != 0
            if not state[w.MORE]:
                state[w.EMPTY] = now_ns
            return False
    state[w.MORE] = 0
    if seen & POLL_BROKEN:
        sleep_until(min(until_ns, now_ns + ABSENT_WAIT_NS), timespec)
        return bool(state[w.IS_PTY] == 0)
    return False


_TYPES = (
    _WORDS,
    _WORDS,
    *[_BYTES] * 3,
    _VALUES,
    _WORDS,
    _VALUES,
    _WORDS,
    _WORDS,
    types.int32[::1],
)


@kernel(int64(int64, int64, RecordType(_TYPES, Memory)))
def serve(file: int, doorbell: int, memory: Memory) -> int:
    """Answer on a line until `STOP` is set (returns 0) or the line is lost (returns 1)."""
    state, slots, chunk, request, out, values, words, frame, info, scratch, poll = (
        memory
    )
    scratch[2] = 1
    one = scratch[2:3]
    while load_acquire(state, w.STOP) == 0:
        now_ns = monotonic_ns(scratch)
        if state[w.TX_COUNT] == 0 and state[w.PENDING_TAIL] < state[w.PENDING_HEAD]:
            _prepare(out, state, slots, values, words, frame, info)
        next_ns = now_ns + LONGEST_WAIT_NS
        if state[w.TX_COUNT] > 0:
            if now_ns >= state[w.TX_DUE]:
                _transmit(file, out, now_ns, state, scratch)
                continue
            next_ns = min(next_ns, state[w.TX_DUE])
        if state[w.RX_COUNT] > 0:
            if now_ns >= state[w.RX_DUE]:
                _receive(chunk, request, state, doorbell, one)
                continue
            sleep_until(min(next_ns, state[w.RX_DUE]), scratch)
            continue
        if stands_alone(state):
            if now_ns - state[w.RX_LAST] >= state[w.PAUSE]:
                _accept_alone(request, state, doorbell, one)
                continue
            next_ns = min(next_ns, state[w.RX_LAST] + state[w.PAUSE])
        if _listen(file, next_ns, now_ns, chunk, state, poll, scratch):
            return 1
    return 0
