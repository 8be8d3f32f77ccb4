"""The ring of published frames: one writer that never waits, readers that never see half a frame.

Each frame starts with its sequence word: odd while it is being written, even when it is complete
(``2 * number + 2`` for frame ``number``). A reader copies the newest complete frame and checks the
sequence word again: if the writer has overwritten the frame meanwhile, the copy is dropped. The
readers here are for kernels; all other readers are in `reader`.
"""

from typing import Any

from hilserver.compiled import inlined
from hilserver.compiled.atomics import fence, load_acquire, store_release
from hilserver.image import word
from hilserver.image.layout import FRAME_HEADER_WORDS, READ_TRIES


@inlined
def _place(number: int, words: Any) -> int:
    row = number & (words[word.RING_LENGTH] - 1)
    return int(words[word.RING_BASE] + row * words[word.RING_STRIDE])


@inlined
def publish_frame(tick: int, planned_ns: int, values: Any, words: Any) -> None:
    """Copy the working frame into the ring and announce it."""
    number = words[word.RING_HEAD]
    base = _place(number, words)
    n_slots = words[word.N_SLOTS]
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    store_release(words, base, 2 * number + 1)
    fence()
    words[base + 1] = tick
    words[base + 2] = planned_ns
    words[base + 3] = words[word.NOW_TAIL]
    data = base + FRAME_HEADER_WORDS
    for slot in range(n_slots):
        values[data + slot] = values[frame + slot]
    for slot in range(n_slots):
        words[data + n_slots + slot] = words[status + slot]
    store_release(words, base, 2 * number + 2)
    store_release(words, word.RING_HEAD, number + 1)


@inlined
def copy_frame(
    number: int, values: Any, words: Any, out_values: Any, out_words: Any
) -> int:
    """Copy frame `number`; return 0, or -1 if the writer has overwritten it.

    Parameters
    ----------
    out_values : ndarray of float64, shape (n_slots,)
    out_words : ndarray of int64, shape (3 + n_slots,)
        Tick, planned time [ns], rows latched so far, and the status codes.
    """
    base = _place(number, words)
    n_slots = words[word.N_SLOTS]
    if load_acquire(words, base) != 2 * number + 2:
        return -1
    out_words[0] = words[base + 1]
    out_words[1] = words[base + 2]
    out_words[2] = words[base + 3]
    data = base + FRAME_HEADER_WORDS
    for slot in range(n_slots):
        out_values[slot] = values[data + slot]
    for slot in range(n_slots):
        out_words[3 + slot] = words[data + n_slots + slot]
    fence()
    return 0 if load_acquire(words, base) == 2 * number + 2 else -1


@inlined
def copy_latest(values: Any, words: Any, out_values: Any, out_words: Any) -> int:
    """Copy the newest complete frame; return its number, -1 before the first, -2 if overrun.

    -2 occurs only if the writer fills the whole ring during one copy, `READ_TRIES` times in a row.
    """
    for _ in range(READ_TRIES):
        head = load_acquire(words, word.RING_HEAD)
        if head == 0:
            return -1
        if copy_frame(head - 1, values, words, out_values, out_words) == 0:
            return int(head - 1)
    return -2
