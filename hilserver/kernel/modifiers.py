"""Faults and forced signals inside the compiled step.

At the start of a tick the true values are restored, the new inputs latched, and the modifiers of
inputs applied; those of outputs are applied before the frame is published. In between, plant and
sensors compute with true outputs: a broken wire behind the encoder does not change the robot.

A modifier depends only on tick, seed and its own state, and may be evaluated again for the same
tick, as the latch of a paused run does: the bits are the same in every pacing back end.
"""

from typing import Any

import hilserver.kernel.modifier_layout as at
from hilserver.compiled import inlined, part
from hilserver.compiled.atomics import load_acquire
from hilserver.compiled.records import record_at
from hilserver.image import word
from hilserver.kernel.modifier_kinds import modify, scale_by_last_wheel, swap
from hilserver.kernel.modifier_layout import Modifiers
from hilserver.kernel.modifier_mail import drain_mail, expire

FORCE, SWAP, LAST_WHEEL = int(at.Kind.FORCE), int(at.Kind.SWAP), int(at.Kind.LAST_WHEEL)


@inlined
def modifiers(words: Any) -> Any:
    """Return the region of the modifiers; an image without modifiers has none."""
    return record_at(words, words[word.MODIFIERS], at.MODIFIERS)


# --- true values ----------------------------------------------------------------------------------


@inlined
def _restore(m: Modifiers, values: Any, words: Any) -> None:
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    for i in range(m.touched):
        slot = m.slots[i]
        values[frame + slot] = m.raw_value[i]
        words[status + slot] = m.raw_status[i]
    m.touched = 0


@part
def _touch(slot: int, m: Modifiers, values: Any, words: Any) -> None:
    """Save the true value of a slot before the first modifier acts on it."""
    n = m.touched
    for i in range(n):
        if m.slots[i] == slot:
            return
    m.slots[n] = slot
    m.raw_value[n] = values[words[word.FRAME_BASE] + slot]
    m.raw_status[n] = words[words[word.STATUS_BASE] + slot]
    m.touched = n + 1


@part
def _act(tick: int, side: int, m: Modifiers, values: Any, words: Any) -> None:
    """Apply all modifiers of one side in the order in which they came; forces last."""
    for forced in range(2):
        for i in range(m.count):
            entry = m.entries[i]
            kind = entry.kind
            is_now = entry.side == side and entry.from_tick <= tick
            if not is_now or (kind == FORCE) != (forced == 1):
                continue
            _touch(entry.slot, m, values, words)
            if kind in (SWAP, LAST_WHEEL):
                _touch(entry.other, m, values, words)
            if kind == SWAP:
                swap(entry, values, words)
            elif kind == LAST_WHEEL:
                scale_by_last_wheel(entry, values, words)
            else:
                modify(tick, entry, m, values, words)


# --- the seams of the step ------------------------------------------------------------------------


@part
def restore_true_values(tick: int, values: Any, words: Any) -> None:
    """Undo the modifiers of the last tick, take new ones, drop those whose time is over."""
    if words[word.MODIFIERS] == 0:
        return
    m = modifiers(words)
    if m.touched > 0:
        _restore(m, values, words)
    if load_acquire(words, word.MAIL_HEAD) != words[word.MAIL_TAIL]:
        drain_mail(tick, m, words)
    if m.count > 0:
        expire(tick, m)
    else:
        m.timeout_dead = 0


@inlined
def watch_commands(tick: int, values: Any, words: Any) -> None:
    """Set the set-points to zero when none has come for `word.COMMAND_LIMIT` ticks."""
    m = modifiers(words)
    if words[word.COMMANDED] != 0 or tick < m.last_command:
        words[word.COMMANDED] = 0
        m.last_command = tick
        m.silent = 0
        return
    silent = tick - m.last_command > words[word.COMMAND_LIMIT]
    if not silent or m.timeout_dead != 0:
        return
    m.timeouts += 1 - m.silent
    m.silent = 1
    for slot in range(words[word.SETPOINT_SLOTS]):
        values[words[word.FRAME_BASE] + slot] = 0.0


@inlined
def modify_inputs(tick: int, values: Any, words: Any) -> None:
    """Apply the modifiers of inputs to the latched values."""
    if words[word.COMMAND_LIMIT] > 0:
        watch_commands(tick, values, words)
    m = modifiers(words)
    if words[word.MODIFIERS] > 0 and m.count > 0:
        _act(tick, at.INPUT, m, values, words)


@inlined
def modify_outputs(tick: int, values: Any, words: Any) -> None:
    """Apply the modifiers of outputs to the values about to be published."""
    m = modifiers(words)
    if words[word.MODIFIERS] > 0 and m.count > 0:
        _act(tick, at.OUTPUT, m, values, words)
