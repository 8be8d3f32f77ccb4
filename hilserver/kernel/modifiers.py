"""Faults and forced signals inside the compiled step.

At the start of a tick the true values come back, the new inputs are latched, and the modifiers of
inputs act; before the frame is published those of outputs act. Between the two, plant and sensors
compute with true outputs: a broken wire behind the encoder does not change the robot.

Every modifier depends on tick, seed and its own state only, and may be evaluated again for the same
tick (the latch of a paused run does so): the bits are the same in every pacing back end.
"""

from typing import Any

import hilserver.kernel.modifier_layout as at
from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire
from hilserver.image import word
from hilserver.kernel.modifier_kinds import modify, scale_by_last_wheel, swap
from hilserver.kernel.modifier_mail import drain_mail, expire

FORCE, SWAP, LAST_WHEEL = int(at.Kind.FORCE), int(at.Kind.SWAP), int(at.Kind.LAST_WHEEL)


# --- true values ----------------------------------------------------------------------------------


@kernel()
def _restore(base: int, values: Any, words: Any) -> None:
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    for i in range(words[base + at.H_TOUCHED]):
        slot = words[base + at.TOUCHED + i]
        values[frame + slot] = values[base + at.RAW_VALUE + i]
        words[status + slot] = words[base + at.RAW_STATUS + i]
    words[base + at.H_TOUCHED] = 0


@kernel()
def _touch(slot: int, base: int, values: Any, words: Any) -> None:
    """Keep the true value of a slot before the first modifier acts on it."""
    n = words[base + at.H_TOUCHED]
    for i in range(n):
        if words[base + at.TOUCHED + i] == slot:
            return
    words[base + at.TOUCHED + n] = slot
    values[base + at.RAW_VALUE + n] = values[words[word.FRAME_BASE] + slot]
    words[base + at.RAW_STATUS + n] = words[words[word.STATUS_BASE] + slot]
    words[base + at.H_TOUCHED] = n + 1


@kernel()
def _act(tick: int, side: int, base: int, values: Any, words: Any) -> None:
    """Let all modifiers of one side act, in the order in which they came; forces last."""
    for forced in range(2):
        for i in range(words[base + at.H_COUNT]):
            entry = base + at.ENTRIES + i * at.N_ENTRY
            kind = words[entry + at.E_KIND]
            is_now = words[entry + at.E_SIDE] == side and words[entry + at.E_FROM] <= tick
            if not is_now or (kind == FORCE) != (forced == 1):
                continue
            _touch(words[entry + at.E_SLOT], base, values, words)
            if kind in (SWAP, LAST_WHEEL):
                _touch(words[entry + at.E_OTHER], base, values, words)
            if kind == SWAP:
                swap(entry, values, words)
            elif kind == LAST_WHEEL:
                scale_by_last_wheel(entry, values, words)
            else:
                modify(tick, entry, base, values, words)


# --- the seams of the step ------------------------------------------------------------------------


@kernel()
def restore_true_values(tick: int, values: Any, words: Any) -> None:
    """Undo the modifiers of the last tick, take new ones, drop those whose time is over."""
    base = words[word.MODIFIERS]
    if base == 0:
        return
    if words[base + at.H_TOUCHED] > 0:
        _restore(base, values, words)
    if load_acquire(words, word.MAIL_HEAD) != words[word.MAIL_TAIL]:
        drain_mail(tick, base, words)
    if words[base + at.H_COUNT] > 0:
        expire(tick, base, words)
    else:
        words[base + at.H_TIMEOUT_DEAD] = 0


@kernel()
def watch_commands(tick: int, values: Any, words: Any) -> None:
    """Set the set-points to zero when none has come for `word.COMMAND_LIMIT` ticks."""
    base = words[word.MODIFIERS]
    if words[word.COMMANDED] != 0 or tick < words[base + at.H_LAST_COMMAND]:
        words[word.COMMANDED] = 0
        words[base + at.H_LAST_COMMAND] = tick
        words[base + at.H_SILENT] = 0
        return
    silent = tick - words[base + at.H_LAST_COMMAND] > words[word.COMMAND_LIMIT]
    if not silent or words[base + at.H_TIMEOUT_DEAD] != 0:
        return
    words[base + at.H_TIMEOUTS] += 1 - words[base + at.H_SILENT]
    words[base + at.H_SILENT] = 1
    for slot in range(words[word.SETPOINT_SLOTS]):
        values[words[word.FRAME_BASE] + slot] = 0.0


@kernel()
def modify_inputs(tick: int, values: Any, words: Any) -> None:
    """Let the modifiers of inputs act on what was latched."""
    if words[word.COMMAND_LIMIT] > 0:
        watch_commands(tick, values, words)
    base = words[word.MODIFIERS]
    if base > 0 and words[base + at.H_COUNT] > 0:
        _act(tick, at.INPUT, base, values, words)


@kernel()
def modify_outputs(tick: int, values: Any, words: Any) -> None:
    """Let the modifiers of outputs act on what is about to be published."""
    base = words[word.MODIFIERS]
    if base > 0 and words[base + at.H_COUNT] > 0:
        _act(tick, at.OUTPUT, base, values, words)
