"""What one modifier does to a value, a pair of values or a twist."""

import math
from typing import Any

from hilserver.compiled import inlined, part
from hilserver.image import word
from hilserver.kernel.modifier_layout import RING_TICKS, Kind, ModifierEntry, Modifiers
from hilserver.plant.noise import normal, uniform
from hilserver.status import GOOD_LOCAL_OVERRIDE, UNCERTAIN_NO_COMMUNICATION

STUCK, NOISE, BIAS, SCALE = (
    int(Kind.STUCK),
    int(Kind.NOISE),
    int(Kind.BIAS),
    int(Kind.SCALE),
)
DELAY, JITTER, DROP = int(Kind.DELAY), int(Kind.JITTER), int(Kind.DROP)
REORDER, HOLD, QUANTISE = int(Kind.REORDER), int(Kind.HOLD), int(Kind.QUANTISE)
SPIKE, DISCONNECT, FORCE = int(Kind.SPIKE), int(Kind.DISCONNECT), int(Kind.FORCE)
UNSIGNED = int(Kind.UNSIGNED)
UART_STEPS_PER_RPM = 100.0
UART_RANGE = 65536.0


@inlined
def _past(tick: int, entry: ModifierEntry, raw: float, m: Modifiers) -> Any:
    """Store `raw` in the entry's ring and fill the ticks that were skipped; return the ring."""
    ring = m.rings[entry.ring]
    last = entry.last
    first = max(last + 1, tick - RING_TICKS + 1)
    for missed in range(first, tick):
        ring[missed & (RING_TICKS - 1)] = ring[last & (RING_TICKS - 1)]
    ring[tick & (RING_TICKS - 1)] = raw
    return ring


@inlined
def _begin(tick: int, entry: ModifierEntry, raw: float) -> None:
    """Set `previous` to the entry's state at the end of the last tick."""
    start = entry.start
    if start < 0 or tick < start:
        entry.start = tick
        start = tick
        entry.last = tick - 1
    if tick == start:
        entry.previous = raw
    elif tick != entry.last:
        entry.previous = entry.state


@inlined
def _from_ring(tick: int, entry: ModifierEntry, raw: float, m: Modifiers) -> float:
    kind, start, seed = entry.kind, entry.start, entry.seed
    channel, sample = entry.channel, tick // entry.every
    ring = _past(tick, entry, raw, m)
    wanted = tick - entry.ticks
    if kind == REORDER and uniform(seed, sample, channel) >= entry.b:
        return raw
    if kind == JITTER:
        share = uniform(seed, sample, channel)
        wanted -= int(share * (entry.spread + 1))
        if tick > start:
            wanted = max(wanted, int(entry.previous))
    wanted = max(wanted, start)
    entry.state = wanted
    return float(ring[wanted & (RING_TICKS - 1)])


@inlined
def _from_state(tick: int, entry: ModifierEntry, raw: float) -> float:
    kind, start = entry.kind, entry.start
    every, a = entry.every, entry.a
    held = entry.previous
    if kind == STUCK and entry.b != 0.0:
        held = a
    elif kind == HOLD and (tick - start) % every == 0:
        held = raw
    elif kind == DROP:
        share = uniform(entry.seed, tick // every, entry.channel)
        if share >= entry.b:
            held = raw
    entry.state = held
    return float(held)


@inlined
def _from_value(tick: int, entry: ModifierEntry, raw: float) -> float:
    kind, a = entry.kind, entry.a
    seed, sample = entry.seed, tick // entry.every
    channel = entry.channel
    if kind == NOISE:
        return float(raw + a * normal(seed, sample, channel))
    if kind == BIAS:
        return float(raw + a)
    if kind == SCALE:
        return float(raw * a)
    if kind == QUANTISE:
        return float(a * math.floor(raw / a + 0.5))
    if kind == SPIKE:
        if uniform(seed, sample, 2 * channel) >= entry.b:
            return raw
        return float(raw + (a if uniform(seed, sample, 2 * channel + 1) < 0.5 else -a))
    if kind == UNSIGNED:
        steps = math.floor(raw * UART_STEPS_PER_RPM + 0.5) % UART_RANGE
        return float(steps / UART_STEPS_PER_RPM)
    return float(a)  # FORCE


@part
def modify(
    tick: int, entry: ModifierEntry, m: Modifiers, values: Any, words: Any
) -> None:
    """Apply a modifier of one signal to its value and status."""
    slot, kind = entry.slot, entry.kind
    place = words[word.FRAME_BASE] + slot
    raw = values[place]
    _begin(tick, entry, raw)
    if entry.ring >= 0:
        value = _from_ring(tick, entry, raw, m)
    elif kind in (STUCK, HOLD, DROP, DISCONNECT):
        value = _from_state(tick, entry, raw)
    else:
        value = _from_value(tick, entry, raw)
    entry.last = tick
    if entry.is_integer != 0:
        value = math.floor(value + 0.5)
        value = min(max(value, entry.low), entry.high)
    if not math.isfinite(value):
        value = raw
    values[place] = value
    if kind == FORCE:
        words[words[word.STATUS_BASE] + slot] = GOOD_LOCAL_OVERRIDE
    elif kind == DISCONNECT:
        words[words[word.STATUS_BASE] + slot] = UNCERTAIN_NO_COMMUNICATION


@inlined
def swap(entry: ModifierEntry, values: Any, words: Any) -> None:
    """Exchange two signals, values and status."""
    a, b = entry.slot, entry.other
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    values[frame + a], values[frame + b] = values[frame + b], values[frame + a]
    words[status + a], words[status + b] = words[status + b], words[status + a]


@inlined
def scale_by_last_wheel(entry: ModifierEntry, values: Any, words: Any) -> None:
    """Limit the twist like a driver that keeps only the factor of the last wheel that is too fast.

    The wheels are checked in the driver's order fl, fr, rl, rr; one that is still too fast is
    limited by its motor, so that the path bends.
    """
    frame = words[word.FRAME_BASE]
    linear, angular = frame + entry.slot, frame + entry.other
    straight = values[linear] * entry.a
    turning = values[angular] * entry.b
    limit = entry.c
    left, right = turning + straight, turning - straight
    factor = 1.0
    if abs(left) > limit:
        factor = limit / abs(left)
    if abs(right) > limit:
        factor = limit / abs(right)
    left = min(max(left * factor, -limit), limit)
    right = min(max(right * factor, -limit), limit)
    values[linear] = 0.5 * (left - right) / entry.a
    values[angular] = 0.5 * (left + right) / entry.b
