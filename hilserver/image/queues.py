"""The two input queues: rows of (tick, slot, value, status) from the sources to the plant.

``now`` holds rows for the next tick, ``timed`` rows for given, rising ticks (scenario, replay).
One producer (the daemon's event loop), one consumer (the plant's tick), no lock: a group of rows is
written first and made visible by one store of the head, so that a tick latches all of it or none.
A row with the value NaN changes only the status; no NaN gets into a frame.
"""

import math
from typing import Any

from hilserver.compiled import kernel, part
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.image import word
from hilserver.image.layout import ROW_WORDS
from hilserver.image.leases import apply_lease, command, driving


@kernel("int64(float64[:, ::1], int64, int64, int64, int64, float64[::1], int64[::1])")
def push_rows(
    rows: Any, base: int, capacity: int, head: int, tail: int, values: Any, words: Any
) -> int:
    """Append all rows or none; return the number appended.

    Parameters
    ----------
    rows : ndarray of float64, shape (n, 4)
        Tick, slot, value, status code.
    base, capacity : int
        The queue's region.
    head, tail : int
        Indices of its control words.
    """
    first = words[head]
    if first + rows.shape[0] - load_acquire(words, tail) > capacity:
        return 0
    for i in range(rows.shape[0]):
        place = base + ((first + i) & (capacity - 1)) * ROW_WORDS
        for column in range(ROW_WORDS):
            values[place + column] = rows[i, column]
    store_release(words, head, first + rows.shape[0])
    return int(rows.shape[0])


@part
def _apply(place: int, values: Any, words: Any) -> None:
    slot, value = int(values[place + 1]), values[place + 2]
    lease, status = words[word.LEASES], int(values[place + 3])
    if lease > 0 and slot >= words[word.N_SLOTS]:
        apply_lease(slot - words[word.N_SLOTS], value, status, values, words)
        return
    if lease > 0 and slot < words[word.SETPOINT_SLOTS] + 2 and words[word.STATE] >= 0:
        kind = int(driving(words).owner)
        if kind >= 0:  # for the row of the source in control
            command(kind, slot, value, status, words)
        return
    if not math.isnan(value):
        values[words[word.FRAME_BASE] + slot] = value
        if slot < words[word.SETPOINT_SLOTS]:
            words[word.COMMANDED] = 1
    words[words[word.STATUS_BASE] + slot] = status


@part
def latch_rows(tick: int, values: Any, words: Any) -> None:
    """Apply the rows due at `tick`: first the timed ones, then those for now, in their order."""
    base, mask = words[word.TIMED_BASE], words[word.TIMED_CAPACITY] - 1
    head, tail = load_acquire(words, word.TIMED_HEAD), words[word.TIMED_TAIL]
    while tail < head and values[base + (tail & mask) * ROW_WORDS] <= tick:
        _apply(base + (tail & mask) * ROW_WORDS, values, words)
        tail += 1
    store_release(words, word.TIMED_TAIL, tail)
    base, mask = words[word.NOW_BASE], words[word.NOW_CAPACITY] - 1
    head, tail = load_acquire(words, word.NOW_HEAD), words[word.NOW_TAIL]
    while tail < head:
        _apply(base + (tail & mask) * ROW_WORDS, values, words)
        tail += 1
    store_release(words, word.NOW_TAIL, tail)
