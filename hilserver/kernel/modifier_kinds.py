"""What one modifier does to a value, a pair of values or a twist."""

import math
from typing import Any

import hilserver.kernel.modifier_layout as at
from hilserver.compiled import kernel
from hilserver.image import word
from hilserver.image.status import GOOD_LOCAL_OVERRIDE, UNCERTAIN_NO_COMMUNICATION
from hilserver.kernel.modifier_layout import Kind
from hilserver.plant.noise import normal, uniform

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


@kernel()
def _past(tick: int, entry: int, raw: float, base: int, values: Any, words: Any) -> int:
    """Note `raw` in the entry's ring, also for ticks that were skipped; return the ring's base."""
    ring = base + at.RINGS + words[entry + at.E_RING] * at.RING_TICKS
    last = words[entry + at.E_LAST]
    first = max(last + 1, tick - at.RING_TICKS + 1)
    for missed in range(first, tick):
        values[ring + (missed & (at.RING_TICKS - 1))] = values[ring + (last & (at.RING_TICKS - 1))]
    values[ring + (tick & (at.RING_TICKS - 1))] = raw
    return int(ring)


@kernel()
def _begin(tick: int, entry: int, raw: float, values: Any, words: Any) -> None:
    """Make the entry's state that of the end of the last tick."""
    start = words[entry + at.E_START]
    if start < 0 or tick < start:
        words[entry + at.E_START] = tick
        start = tick
        words[entry + at.E_LAST] = tick - 1
    if tick == start:
        values[entry + at.E_PREVIOUS] = raw
    elif tick != words[entry + at.E_LAST]:
        values[entry + at.E_PREVIOUS] = values[entry + at.E_STATE]


@kernel()
def _from_ring(tick: int, entry: int, raw: float, base: int, values: Any, words: Any) -> float:
    kind, start, seed = (
        words[entry + at.E_KIND],
        words[entry + at.E_START],
        words[entry + at.E_SEED],
    )
    channel, sample = words[entry + at.E_CHANNEL], tick // words[entry + at.E_EVERY]
    ring = _past(tick, entry, raw, base, values, words)
    wanted = tick - words[entry + at.E_TICKS]
    if kind == REORDER and uniform(seed, sample, channel) >= values[entry + at.E_B]:
        return raw
    if kind == JITTER:
        share = uniform(seed, sample, channel)
        wanted -= int(share * (words[entry + at.E_SPREAD] + 1))
        if tick > start:
            wanted = max(wanted, int(values[entry + at.E_PREVIOUS]))
    wanted = max(wanted, start)
    values[entry + at.E_STATE] = wanted
    return float(values[ring + (wanted & (at.RING_TICKS - 1))])


@kernel()
def _from_state(tick: int, entry: int, raw: float, values: Any, words: Any) -> float:
    kind, start = words[entry + at.E_KIND], words[entry + at.E_START]
    every, a = words[entry + at.E_EVERY], values[entry + at.E_A]
    held = values[entry + at.E_PREVIOUS]
    if kind == STUCK and values[entry + at.E_B] != 0.0:
        held = a
    elif kind == HOLD and (tick - start) % every == 0:
        held = raw
    elif kind == DROP:
        share = uniform(words[entry + at.E_SEED], tick // every, words[entry + at.E_CHANNEL])
        if share >= values[entry + at.E_B]:
            held = raw
    values[entry + at.E_STATE] = held
    return float(held)


@kernel()
def _from_value(tick: int, entry: int, raw: float, values: Any, words: Any) -> float:
    kind, a = words[entry + at.E_KIND], values[entry + at.E_A]
    seed, sample = words[entry + at.E_SEED], tick // words[entry + at.E_EVERY]
    channel = words[entry + at.E_CHANNEL]
    if kind == NOISE:
        return float(raw + a * normal(seed, sample, channel))
    if kind == BIAS:
        return float(raw + a)
    if kind == SCALE:
        return float(raw * a)
    if kind == QUANTISE:
        return float(a * math.floor(raw / a + 0.5))
    if kind == SPIKE:
        if uniform(seed, sample, 2 * channel) >= values[entry + at.E_B]:
            return raw
        return float(raw + (a if uniform(seed, sample, 2 * channel + 1) < 0.5 else -a))
    if kind == UNSIGNED:
        steps = math.floor(raw * UART_STEPS_PER_RPM + 0.5) % UART_RANGE
        return float(steps / UART_STEPS_PER_RPM)
    return float(a)  # FORCE


@kernel()
def modify(tick: int, entry: int, base: int, values: Any, words: Any) -> None:
    """Let a modifier of one signal act on its value and status."""
    slot, kind = words[entry + at.E_SLOT], words[entry + at.E_KIND]
    place = words[word.FRAME_BASE] + slot
    raw = values[place]
    _begin(tick, entry, raw, values, words)
    if words[entry + at.E_RING] >= 0:
        value = _from_ring(tick, entry, raw, base, values, words)
    elif kind in (STUCK, HOLD, DROP, DISCONNECT):
        value = _from_state(tick, entry, raw, values, words)
    else:
        value = _from_value(tick, entry, raw, values, words)
    words[entry + at.E_LAST] = tick
    if words[entry + at.E_INTEGER] != 0:
        value = math.floor(value + 0.5)
        value = min(max(value, values[entry + at.E_LOW]), values[entry + at.E_HIGH])
    if not math.isfinite(value):
        value = raw
    values[place] = value
    if kind == FORCE:
        words[words[word.STATUS_BASE] + slot] = GOOD_LOCAL_OVERRIDE
    elif kind == DISCONNECT:
        words[words[word.STATUS_BASE] + slot] = UNCERTAIN_NO_COMMUNICATION


@kernel()
def swap(entry: int, values: Any, words: Any) -> None:
    """Exchange two signals, values and status."""
    a, b = words[entry + at.E_SLOT], words[entry + at.E_OTHER]
    frame, status = words[word.FRAME_BASE], words[word.STATUS_BASE]
    values[frame + a], values[frame + b] = values[frame + b], values[frame + a]
    words[status + a], words[status + b] = words[status + b], words[status + a]


@kernel()
def scale_by_last_wheel(entry: int, values: Any, words: Any) -> None:
    """Limit the twist as a driver does that keeps the last offending wheel's factor.

    The wheels are looked at in the driver's order fl, fr, rl, rr; a wheel that is still too fast
    is cut off by its motor, so that the path bends.
    """
    frame = words[word.FRAME_BASE]
    linear, angular = frame + words[entry + at.E_SLOT], frame + words[entry + at.E_OTHER]
    straight = values[linear] * values[entry + at.E_A]
    turning = values[angular] * values[entry + at.E_B]
    limit = values[entry + at.E_C]
    left, right = turning + straight, turning - straight
    factor = 1.0
    if abs(left) > limit:
        factor = limit / abs(left)
    if abs(right) > limit:
        factor = limit / abs(right)
    left = min(max(left * factor, -limit), limit)
    right = min(max(right * factor, -limit), limit)
    values[linear] = 0.5 * (left - right) / values[entry + at.E_A]
    values[angular] = 0.5 * (left + right) / values[entry + at.E_B]
