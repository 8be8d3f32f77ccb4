"""How modifiers come and go inside the compiled step: by mail, and by their time."""

from typing import Any

import hilserver.kernel.modifier_layout as at
from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.image import word

DELAY, JITTER, REORDER = int(at.Kind.DELAY), int(at.Kind.JITTER), int(at.Kind.REORDER)
FORCE, DEAD_TIMEOUT = int(at.Kind.FORCE), int(at.Kind.DEAD_TIMEOUT)


@kernel("void(int64, int64[::1])")
def show_mail(head: int, words: Any) -> None:
    """Show all commands before `head` to the plant, at once."""
    store_release(words, word.MAIL_HEAD, head)


@kernel()
def _take_ring(base: int, words: Any) -> int:
    for ring in range(at.MAX_RINGS):
        if words[base + at.H_RINGS] & (1 << ring) == 0:
            words[base + at.H_RINGS] |= 1 << ring
            return ring
    return -1


@kernel()
def _add(tick: int, row: int, base: int, words: Any) -> None:
    kind = words[row + at.E_KIND]
    needs_ring = kind in (DELAY, JITTER, REORDER)
    if words[base + at.H_COUNT] >= at.MAX_MODIFIERS:
        words[base + at.H_DROPPED] += 1
        return
    ring = _take_ring(base, words) if needs_ring else -1
    if needs_ring and ring < 0:
        words[base + at.H_DROPPED] += 1
        return
    entry = base + at.ENTRIES + words[base + at.H_COUNT] * at.N_ENTRY
    for i in range(at.N_COMMAND):
        words[entry + i] = words[row + i]
    if words[entry + at.E_FROM] == at.NOW:
        words[entry + at.E_FROM] = tick
        if words[entry + at.E_UNTIL] < at.FOREVER:
            words[entry + at.E_UNTIL] += tick
    words[entry + at.E_RING] = ring
    words[entry + at.E_START] = -1
    words[base + at.H_COUNT] += 1


@kernel()
def _keep(keeps: bool, entry: int, kept: int, base: int, words: Any) -> int:
    """Move a kept entry down to place `kept`, free the ring of another; return the next place."""
    if not keeps:
        if words[entry + at.E_RING] >= 0:
            words[base + at.H_RINGS] &= ~(1 << words[entry + at.E_RING])
        return kept
    place = base + at.ENTRIES + kept * at.N_ENTRY
    if place != entry:
        for i in range(at.N_ENTRY):
            words[place + i] = words[entry + i]
    return kept + 1


@kernel()
def _remove(operation: int, number: int, base: int, words: Any) -> None:
    kept = 0
    for i in range(words[base + at.H_COUNT]):
        entry = base + at.ENTRIES + i * at.N_ENTRY
        if operation == at.OP_REMOVE:
            keeps = words[entry + at.E_ID] != number
        else:
            keeps = operation != at.OP_CLEAR_ALL and words[entry + at.E_KIND] == FORCE
        kept = _keep(keeps, entry, kept, base, words)
    words[base + at.H_COUNT] = kept


@kernel()
def drain_mail(tick: int, base: int, words: Any) -> None:
    """Take the commands that are shown; a modifier that begins now begins with `tick`."""
    head, tail = load_acquire(words, word.MAIL_HEAD), words[word.MAIL_TAIL]
    while tail < head:
        row = words[word.MAIL_BASE] + (tail & (at.MAIL_ROWS - 1)) * at.MAIL_ROW
        if words[row] == at.OP_ADD:
            _add(tick, row + 1, base, words)
        elif words[row] == at.OP_SKIP_TIMED:
            words[word.TIMED_TAIL] = max(words[word.TIMED_TAIL], words[row + 1 + at.E_ID])
        else:
            _remove(words[row], words[row + 1 + at.E_ID], base, words)
        tail += 1
    store_release(words, word.MAIL_TAIL, tail)


@kernel()
def expire(tick: int, base: int, words: Any) -> None:
    """Drop modifiers whose time is over; note whether one keeps the time-out from acting."""
    kept = 0
    words[base + at.H_TIMEOUT_DEAD] = 0
    for i in range(words[base + at.H_COUNT]):
        entry = base + at.ENTRIES + i * at.N_ENTRY
        keeps = tick < words[entry + at.E_UNTIL]
        if keeps and words[entry + at.E_KIND] == DEAD_TIMEOUT and tick >= words[entry + at.E_FROM]:
            words[base + at.H_TIMEOUT_DEAD] = 1
        kept = _keep(keeps, entry, kept, base, words)
    words[base + at.H_COUNT] = kept
