"""Faults and forced signals inside the compiled step.

At the start of a tick the true values come back, the new inputs are latched, and the modifiers of
inputs act; before the frame is published those of outputs act. Between the two, plant and sensors
compute with true outputs: a broken wire behind the encoder does not change the robot.

Every modifier depends on tick, seed and its own state only, and may be evaluated again for the same
tick (the latch of a paused run does so): the bits are the same in every pacing back end.
"""

import math
from typing import Any

from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.image.layout import (
    W_COMMAND_LIMIT,
    W_COMMANDED,
    W_FRAME_BASE,
    W_MAIL_BASE,
    W_MAIL_HEAD,
    W_MAIL_TAIL,
    W_MODIFIERS,
    W_SETPOINT_SLOTS,
    W_STATUS_BASE,
    W_TIMED_TAIL,
)
from hilserver.kernel.modifier_layout import (
    E_A,
    E_B,
    E_C,
    E_CHANNEL,
    E_EVERY,
    E_FROM,
    E_HIGH,
    E_ID,
    E_INTEGER,
    E_KIND,
    E_LAST,
    E_LOW,
    E_OTHER,
    E_PREVIOUS,
    E_RING,
    E_SEED,
    E_SIDE,
    E_SLOT,
    E_SPREAD,
    E_START,
    E_STATE,
    E_TICKS,
    E_UNTIL,
    ENTRIES,
    FOREVER,
    H_COUNT,
    H_DROPPED,
    H_LAST_COMMAND,
    H_RINGS,
    H_SILENT,
    H_TIMEOUT_DEAD,
    H_TIMEOUTS,
    H_TOUCHED,
    INPUT,
    MAIL_ROW,
    MAIL_ROWS,
    MAX_MODIFIERS,
    MAX_RINGS,
    N_COMMAND,
    N_ENTRY,
    NOW,
    OP_ADD,
    OP_CLEAR_ALL,
    OP_REMOVE,
    OP_SKIP_TIMED,
    OUTPUT,
    RAW_STATUS,
    RAW_VALUE,
    RING_TICKS,
    RINGS,
    TOUCHED,
    Kind,
)
from hilserver.plant.noise import normal, uniform
from hilserver.status import GOOD_LOCAL_OVERRIDE, UNCERTAIN_NO_COMMUNICATION

STUCK, NOISE, BIAS, SCALE = int(Kind.STUCK), int(Kind.NOISE), int(Kind.BIAS), int(Kind.SCALE)
DELAY, JITTER, DROP = int(Kind.DELAY), int(Kind.JITTER), int(Kind.DROP)
REORDER, HOLD, QUANTISE = int(Kind.REORDER), int(Kind.HOLD), int(Kind.QUANTISE)
SPIKE, DISCONNECT, FORCE = int(Kind.SPIKE), int(Kind.DISCONNECT), int(Kind.FORCE)
SWAP, UNSIGNED = int(Kind.SWAP), int(Kind.UNSIGNED)
LAST_WHEEL, DEAD_TIMEOUT = int(Kind.LAST_WHEEL), int(Kind.DEAD_TIMEOUT)
UART_STEPS_PER_RPM = 100.0
UART_RANGE = 65536.0


# --- commands -------------------------------------------------------------------------------------


@kernel("void(int64, int64[::1])")
def show_mail(head: int, words: Any) -> None:
    """Show all commands before `head` to the plant, at once."""
    store_release(words, W_MAIL_HEAD, head)


@kernel()
def _take_ring(base: int, words: Any) -> int:
    for ring in range(MAX_RINGS):
        if words[base + H_RINGS] & (1 << ring) == 0:
            words[base + H_RINGS] |= 1 << ring
            return ring
    return -1


@kernel()
def _add(tick: int, row: int, base: int, words: Any) -> None:
    kind = words[row + E_KIND]
    needs_ring = kind in (DELAY, JITTER, REORDER)
    if words[base + H_COUNT] >= MAX_MODIFIERS:
        words[base + H_DROPPED] += 1
        return
    ring = _take_ring(base, words) if needs_ring else -1
    if needs_ring and ring < 0:
        words[base + H_DROPPED] += 1
        return
    entry = base + ENTRIES + words[base + H_COUNT] * N_ENTRY
    for i in range(N_COMMAND):
        words[entry + i] = words[row + i]
    if words[entry + E_FROM] == NOW:
        words[entry + E_FROM] = tick
        if words[entry + E_UNTIL] < FOREVER:
            words[entry + E_UNTIL] += tick
    words[entry + E_RING] = ring
    words[entry + E_START] = -1
    words[base + H_COUNT] += 1


@kernel()
def _keep(keeps: bool, entry: int, kept: int, base: int, words: Any) -> int:
    """Move a kept entry down to place `kept`, free the ring of another; return the next place."""
    if not keeps:
        if words[entry + E_RING] >= 0:
            words[base + H_RINGS] &= ~(1 << words[entry + E_RING])
        return kept
    place = base + ENTRIES + kept * N_ENTRY
    if place != entry:
        for i in range(N_ENTRY):
            words[place + i] = words[entry + i]
    return kept + 1


@kernel()
def _remove(operation: int, number: int, base: int, words: Any) -> None:
    kept = 0
    for i in range(words[base + H_COUNT]):
        entry = base + ENTRIES + i * N_ENTRY
        if operation == OP_REMOVE:
            keeps = words[entry + E_ID] != number
        else:
            keeps = operation != OP_CLEAR_ALL and words[entry + E_KIND] == FORCE
        kept = _keep(keeps, entry, kept, base, words)
    words[base + H_COUNT] = kept


@kernel()
def _drain_mail(tick: int, base: int, words: Any) -> None:
    head, tail = load_acquire(words, W_MAIL_HEAD), words[W_MAIL_TAIL]
    while tail < head:
        row = words[W_MAIL_BASE] + (tail & (MAIL_ROWS - 1)) * MAIL_ROW
        if words[row] == OP_ADD:
            _add(tick, row + 1, base, words)
        elif words[row] == OP_SKIP_TIMED:
            words[W_TIMED_TAIL] = max(words[W_TIMED_TAIL], words[row + 1 + E_ID])
        else:
            _remove(words[row], words[row + 1 + E_ID], base, words)
        tail += 1
    store_release(words, W_MAIL_TAIL, tail)


@kernel()
def _expire(tick: int, base: int, words: Any) -> None:
    kept = 0
    words[base + H_TIMEOUT_DEAD] = 0
    for i in range(words[base + H_COUNT]):
        entry = base + ENTRIES + i * N_ENTRY
        keeps = tick < words[entry + E_UNTIL]
        if keeps and words[entry + E_KIND] == DEAD_TIMEOUT and tick >= words[entry + E_FROM]:
            words[base + H_TIMEOUT_DEAD] = 1
        kept = _keep(keeps, entry, kept, base, words)
    words[base + H_COUNT] = kept


# --- true values ----------------------------------------------------------------------------------


@kernel()
def _restore(base: int, values: Any, words: Any) -> None:
    frame, status = words[W_FRAME_BASE], words[W_STATUS_BASE]
    for i in range(words[base + H_TOUCHED]):
        slot = words[base + TOUCHED + i]
        values[frame + slot] = values[base + RAW_VALUE + i]
        words[status + slot] = words[base + RAW_STATUS + i]
    words[base + H_TOUCHED] = 0


@kernel()
def _touch(slot: int, base: int, values: Any, words: Any) -> None:
    """Keep the true value of a slot before the first modifier acts on it."""
    n = words[base + H_TOUCHED]
    for i in range(n):
        if words[base + TOUCHED + i] == slot:
            return
    words[base + TOUCHED + n] = slot
    values[base + RAW_VALUE + n] = values[words[W_FRAME_BASE] + slot]
    words[base + RAW_STATUS + n] = words[words[W_STATUS_BASE] + slot]
    words[base + H_TOUCHED] = n + 1


# --- one modifier ---------------------------------------------------------------------------------


@kernel()
def _past(tick: int, entry: int, raw: float, base: int, values: Any, words: Any) -> int:
    """Note `raw` in the entry's ring, also for ticks that were skipped; return the ring's base."""
    ring = base + RINGS + words[entry + E_RING] * RING_TICKS
    last = words[entry + E_LAST]
    first = max(last + 1, tick - RING_TICKS + 1)
    for missed in range(first, tick):
        values[ring + (missed & (RING_TICKS - 1))] = values[ring + (last & (RING_TICKS - 1))]
    values[ring + (tick & (RING_TICKS - 1))] = raw
    return int(ring)


@kernel()
def _begin(tick: int, entry: int, raw: float, values: Any, words: Any) -> None:
    """Make the entry's state that of the end of the last tick."""
    start = words[entry + E_START]
    if start < 0 or tick < start:
        words[entry + E_START] = tick
        start = tick
        words[entry + E_LAST] = tick - 1
    if tick == start:
        values[entry + E_PREVIOUS] = raw
    elif tick != words[entry + E_LAST]:
        values[entry + E_PREVIOUS] = values[entry + E_STATE]


@kernel()
def _from_ring(tick: int, entry: int, raw: float, base: int, values: Any, words: Any) -> float:
    kind, start, seed = words[entry + E_KIND], words[entry + E_START], words[entry + E_SEED]
    channel, sample = words[entry + E_CHANNEL], tick // words[entry + E_EVERY]
    ring = _past(tick, entry, raw, base, values, words)
    wanted = tick - words[entry + E_TICKS]
    if kind == REORDER and uniform(seed, sample, channel) >= values[entry + E_B]:
        return raw
    if kind == JITTER:
        share = uniform(seed, sample, channel)
        wanted -= int(share * (words[entry + E_SPREAD] + 1))
        if tick > start:
            wanted = max(wanted, int(values[entry + E_PREVIOUS]))
    wanted = max(wanted, start)
    values[entry + E_STATE] = wanted
    return float(values[ring + (wanted & (RING_TICKS - 1))])


@kernel()
def _from_state(tick: int, entry: int, raw: float, values: Any, words: Any) -> float:
    kind, start = words[entry + E_KIND], words[entry + E_START]
    every, a = words[entry + E_EVERY], values[entry + E_A]
    held = values[entry + E_PREVIOUS]
    if kind == STUCK and values[entry + E_B] != 0.0:
        held = a
    elif kind == HOLD and (tick - start) % every == 0:
        held = raw
    elif kind == DROP:
        share = uniform(words[entry + E_SEED], tick // every, words[entry + E_CHANNEL])
        if share >= values[entry + E_B]:
            held = raw
    values[entry + E_STATE] = held
    return float(held)


@kernel()
def _from_value(tick: int, entry: int, raw: float, values: Any, words: Any) -> float:
    kind, a = words[entry + E_KIND], values[entry + E_A]
    seed, sample = words[entry + E_SEED], tick // words[entry + E_EVERY]
    channel = words[entry + E_CHANNEL]
    if kind == NOISE:
        return float(raw + a * normal(seed, sample, channel))
    if kind == BIAS:
        return float(raw + a)
    if kind == SCALE:
        return float(raw * a)
    if kind == QUANTISE:
        return float(a * math.floor(raw / a + 0.5))
    if kind == SPIKE:
        if uniform(seed, sample, 2 * channel) >= values[entry + E_B]:
            return raw
        return float(raw + (a if uniform(seed, sample, 2 * channel + 1) < 0.5 else -a))
    if kind == UNSIGNED:
        steps = math.floor(raw * UART_STEPS_PER_RPM + 0.5) % UART_RANGE
        return float(steps / UART_STEPS_PER_RPM)
    return float(a)  # FORCE


@kernel()
def _modify(tick: int, entry: int, base: int, values: Any, words: Any) -> None:
    slot, kind = words[entry + E_SLOT], words[entry + E_KIND]
    place = words[W_FRAME_BASE] + slot
    raw = values[place]
    _begin(tick, entry, raw, values, words)
    if words[entry + E_RING] >= 0:
        value = _from_ring(tick, entry, raw, base, values, words)
    elif kind in (STUCK, HOLD, DROP, DISCONNECT):
        value = _from_state(tick, entry, raw, values, words)
    else:
        value = _from_value(tick, entry, raw, values, words)
    words[entry + E_LAST] = tick
    if words[entry + E_INTEGER] != 0:
        value = math.floor(value + 0.5)
        value = min(max(value, values[entry + E_LOW]), values[entry + E_HIGH])
    if not math.isfinite(value):
        value = raw
    values[place] = value
    if kind == FORCE:
        words[words[W_STATUS_BASE] + slot] = GOOD_LOCAL_OVERRIDE
    elif kind == DISCONNECT:
        words[words[W_STATUS_BASE] + slot] = UNCERTAIN_NO_COMMUNICATION


@kernel()
def _swap(entry: int, values: Any, words: Any) -> None:
    a, b = words[entry + E_SLOT], words[entry + E_OTHER]
    frame, status = words[W_FRAME_BASE], words[W_STATUS_BASE]
    values[frame + a], values[frame + b] = values[frame + b], values[frame + a]
    words[status + a], words[status + b] = words[status + b], words[status + a]


@kernel()
def _scale_by_last_wheel(entry: int, values: Any, words: Any) -> None:
    """Limit the twist as a driver does that keeps the last offending wheel's factor.

    The wheels are looked at in the driver's order fl, fr, rl, rr; a wheel that is still too fast
    is cut off by its motor, so that the path bends.
    """
    frame = words[W_FRAME_BASE]
    linear, angular = frame + words[entry + E_SLOT], frame + words[entry + E_OTHER]
    straight = values[linear] * values[entry + E_A]
    turning = values[angular] * values[entry + E_B]
    limit = values[entry + E_C]
    left, right = turning + straight, turning - straight
    factor = 1.0
    if abs(left) > limit:
        factor = limit / abs(left)
    if abs(right) > limit:
        factor = limit / abs(right)
    left = min(max(left * factor, -limit), limit)
    right = min(max(right * factor, -limit), limit)
    values[linear] = 0.5 * (left - right) / values[entry + E_A]
    values[angular] = 0.5 * (left + right) / values[entry + E_B]


@kernel()
def _act(tick: int, side: int, base: int, values: Any, words: Any) -> None:
    """Let all modifiers of one side act, in the order in which they came; forces last."""
    for forced in range(2):
        for i in range(words[base + H_COUNT]):
            entry = base + ENTRIES + i * N_ENTRY
            kind = words[entry + E_KIND]
            is_now = words[entry + E_SIDE] == side and words[entry + E_FROM] <= tick
            if not is_now or (kind == FORCE) != (forced == 1):
                continue
            _touch(words[entry + E_SLOT], base, values, words)
            if kind in (SWAP, LAST_WHEEL):
                _touch(words[entry + E_OTHER], base, values, words)
            if kind == SWAP:
                _swap(entry, values, words)
            elif kind == LAST_WHEEL:
                _scale_by_last_wheel(entry, values, words)
            else:
                _modify(tick, entry, base, values, words)


# --- the seams of the step ------------------------------------------------------------------------


@kernel()
def restore_true_values(tick: int, values: Any, words: Any) -> None:
    """Undo the modifiers of the last tick, take new ones, drop those whose time is over."""
    base = words[W_MODIFIERS]
    if base == 0:
        return
    if words[base + H_TOUCHED] > 0:
        _restore(base, values, words)
    if load_acquire(words, W_MAIL_HEAD) != words[W_MAIL_TAIL]:
        _drain_mail(tick, base, words)
    if words[base + H_COUNT] > 0:
        _expire(tick, base, words)
    else:
        words[base + H_TIMEOUT_DEAD] = 0


@kernel()
def watch_commands(tick: int, values: Any, words: Any) -> None:
    """Set the set-points to zero when none has come for `W_COMMAND_LIMIT` ticks."""
    base = words[W_MODIFIERS]
    if words[W_COMMANDED] != 0 or tick < words[base + H_LAST_COMMAND]:
        words[W_COMMANDED] = 0
        words[base + H_LAST_COMMAND] = tick
        words[base + H_SILENT] = 0
        return
    silent = tick - words[base + H_LAST_COMMAND] > words[W_COMMAND_LIMIT]
    if not silent or words[base + H_TIMEOUT_DEAD] != 0:
        return
    words[base + H_TIMEOUTS] += 1 - words[base + H_SILENT]
    words[base + H_SILENT] = 1
    for slot in range(words[W_SETPOINT_SLOTS]):
        values[words[W_FRAME_BASE] + slot] = 0.0


@kernel()
def modify_inputs(tick: int, values: Any, words: Any) -> None:
    """Let the modifiers of inputs act on what was latched."""
    if words[W_COMMAND_LIMIT] > 0:
        watch_commands(tick, values, words)
    base = words[W_MODIFIERS]
    if base > 0 and words[base + H_COUNT] > 0:
        _act(tick, INPUT, base, values, words)


@kernel()
def modify_outputs(tick: int, values: Any, words: Any) -> None:
    """Let the modifiers of outputs act on what is about to be published."""
    base = words[W_MODIFIERS]
    if base > 0 and words[base + H_COUNT] > 0:
        _act(tick, OUTPUT, base, values, words)
