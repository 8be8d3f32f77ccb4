"""Finds requests in a stream of bytes, and synchronises again when bytes are lost or wrong.

A request begins with `START` and is `REQUEST_BYTES` long. A window of that length with a wrong end
is shifted to the next `START` that a known command follows. A window with the wrong start can look
right if the payload contains the end followed by the start; so, while in doubt, a pause on the line
begins a new frame (hosts keep 8 ms between requests). In step, pauses are neither needed nor
harmful: a USB adapter may split a request.

One deviation is tolerated, because a real driver needs it: with the variant ``iotbot``, eleven
bytes alone between two pauses are a request whatever their last byte is.
"""

from typing import Any, Final

import numpy as np

from hilserver.compiled import inlined, part
from hilserver.io.shield import words as w
from hilserver.io.shield.protocol import (
    CHECKED_BYTES,
    END,
    KNOWN,
    REQUEST_BYTES,
    START,
    crc8,
)

NOTHING: Final = 0
COMPLETE: Final = 1
XON, XOFF = 0x11, 0x13  # a terminal may send them: noise between requests
_KNOWN = np.array([number in KNOWN for number in range(256)])


@part
def _shift(buffer: Any, state: Any) -> None:
    """Drop the first byte, and following ones that cannot begin a request."""
    fill = state[w.FILL]
    first = 1
    while first < fill:
        next_known = first + 1 == fill or _KNOWN[buffer[first + 1]]
        if buffer[first] == START and next_known:
            break
        first += 1
    for i in range(first, fill):
        buffer[i - first] = buffer[i]
    state[w.FILL] = fill - first
    state[w.SKIPPED] += first
    state[w.IN_STEP] = state[w.CLEAN] = 0


@inlined
def stands_alone(state: Any) -> bool:
    """Whether a whole request without its end waits for the pause that makes it one."""
    return bool(state[w.FILL] == REQUEST_BYTES)


@inlined
def feed(byte: int, after_pause: bool, buffer: Any, state: Any) -> int:
    """Take one byte; return `COMPLETE` when `buffer` holds a request.

    Parameters
    ----------
    after_pause : bool
        Nothing had come for at least the length of a pause.
    buffer : ndarray of uint8, shape (REQUEST_BYTES,)
    state : ndarray of int64
        The framing words are changed.
    """
    if after_pause and state[w.IN_STEP] == 0 and state[w.FILL] > 0:
        state[w.SKIPPED] += state[w.FILL]
        state[w.FILL] = 0
    if stands_alone(state):
        _shift(buffer, state)
    if after_pause:
        state[w.CLEAN] = state[w.FILL] == 0
    if state[w.FILL] == 0 and byte != START:
        state[w.SKIPPED] += 1
        if byte not in (XON, XOFF):
            state[w.IN_STEP] = state[w.CLEAN] = 0
        return NOTHING
    buffer[state[w.FILL]] = byte
    state[w.FILL] += 1
    if state[w.FILL] < REQUEST_BYTES:
        if state[w.FILL] == 2 and state[w.CLEAN] == 0 and not _KNOWN[byte]:
            _shift(buffer, state)
        return NOTHING
    wanted = crc8(buffer, 0, CHECKED_BYTES) if state[w.CRC] != 0 else END
    if byte == wanted:
        state[w.FILL] = 0
        state[w.IN_STEP] |= state[w.CLEAN]
        state[w.CLEAN] = state[w.IN_STEP]
        return COMPLETE
    if state[w.CLEAN] == 0 or state[w.CRC] != 0:
        _shift(buffer, state)
    return NOTHING
