"""How modifiers start and end inside the compiled step: by mail, or when their time is over."""

from typing import Any

import hilserver.kernel.modifier_layout as at
from hilserver.compiled import inlined, kernel
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.compiled.records import assign, record_at
from hilserver.image import word
from hilserver.kernel.modifier_layout import ModifierEntry, Modifiers

DELAY, JITTER, REORDER = int(at.Kind.DELAY), int(at.Kind.JITTER), int(at.Kind.REORDER)
FORCE, DEAD_TIMEOUT = int(at.Kind.FORCE), int(at.Kind.DEAD_TIMEOUT)


@kernel("void(int64, int64[::1])")
def show_mail(head: int, words: Any) -> None:
    """Make all commands before `head` visible to the plant, at once."""
    store_release(words, word.MAIL_HEAD, head)


@inlined
def _take_ring(m: Modifiers) -> int:
    for ring in range(at.MAX_RINGS):
        if m.rings_in_use & (1 << ring) == 0:
            m.rings_in_use |= 1 << ring
            return ring
    return -1


@inlined
def _add(tick: int, order: ModifierEntry, m: Modifiers) -> None:
    needs_ring = order.kind in (DELAY, JITTER, REORDER)
    if m.count >= at.MAX_MODIFIERS:
        m.dropped += 1
        return
    ring = _take_ring(m) if needs_ring else -1
    if needs_ring and ring < 0:
        m.dropped += 1
        return
    entry = m.entries[m.count]
    assign(entry, order)
    if entry.from_tick == at.NOW:
        entry.from_tick = tick
        if entry.until_tick < at.FOREVER:
            entry.until_tick += tick
    entry.ring = ring
    entry.start = -1
    m.count += 1


@inlined
def _keep(keeps: bool, i: int, kept: int, m: Modifiers) -> int:
    """Move an entry to place `kept`, or free its ring if it goes; return the next place."""
    entry = m.entries[i]
    if not keeps:
        if entry.ring >= 0:
            m.rings_in_use &= ~(1 << entry.ring)
        return kept
    if kept != i:
        assign(m.entries[kept], entry)
    return kept + 1


@inlined
def _remove(operation: int, number: int, m: Modifiers) -> None:
    kept = 0
    for i in range(m.count):
        entry = m.entries[i]
        if operation == at.OP_REMOVE:
            keeps = entry.number != number
        else:
            keeps = operation != at.OP_CLEAR_ALL and entry.kind == FORCE
        kept = _keep(keeps, i, kept, m)
    m.count = kept


@inlined
def drain_mail(tick: int, m: Modifiers, words: Any) -> None:
    """Take the visible commands; a modifier that begins now begins with `tick`."""
    head, tail = load_acquire(words, word.MAIL_HEAD), words[word.MAIL_TAIL]
    while tail < head:
        place = words[word.MAIL_BASE] + (tail & (at.MAIL_ROWS - 1)) * at.MAIL_ROW
        mail = record_at(words, place, at.MAIL)
        if mail.operation == at.OP_ADD:
            _add(tick, mail.entry, m)
        elif mail.operation == at.OP_SKIP_TIMED:
            words[word.TIMED_TAIL] = max(words[word.TIMED_TAIL], mail.entry.number)
        else:
            _remove(mail.operation, mail.entry.number, m)
        tail += 1
    store_release(words, word.MAIL_TAIL, tail)


@inlined
def expire(tick: int, m: Modifiers) -> None:
    """Drop modifiers whose time is over; note whether one disables the command time-out."""
    kept = 0
    m.timeout_dead = 0
    for i in range(m.count):
        entry = m.entries[i]
        keeps = tick < entry.until_tick
        if keeps and entry.kind == DEAD_TIMEOUT and tick >= entry.from_tick:
            m.timeout_dead = 1
        kept = _keep(keeps, i, kept, m)
    m.count = kept
