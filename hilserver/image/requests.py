"""Snapshot and restore of everything that lives, in one copy between two ticks.

The daemon fills or reads the shadow copy and posts a request; the plant's next latch serves it.
The live regions lie in one piece, so that a request costs one copy of some ten kilobytes.
"""

from typing import Any

from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.image.layout import (
    REQUEST_LOAD,
    W_LIVE_BASE,
    W_LIVE_LENGTH,
    W_REQUEST,
    W_REQUEST_DONE,
    W_REQUEST_KIND,
    W_REQUEST_TICK,
    W_SHADOW_BASE,
)


@kernel("int64(int64, int64, int64[::1])")
def post_request(kind: int, tick: int, words: Any) -> int:
    """Ask the plant to save its state to the shadow copy or to load it; return the number."""
    words[W_REQUEST_KIND] = kind
    words[W_REQUEST_TICK] = tick
    number = words[W_REQUEST] + 1
    store_release(words, W_REQUEST, number)
    return int(number)


@kernel("boolean(int64, int64[::1])")
def is_done(number: int, words: Any) -> bool:
    """Whether request `number` has been served."""
    return bool(load_acquire(words, W_REQUEST_DONE) >= number)


@kernel()
def serve_request(tick: int, words: Any) -> int:
    """Serve the pending request, if any; return the tick to go on with."""
    number = load_acquire(words, W_REQUEST)
    if number == words[W_REQUEST_DONE]:
        return tick
    live, shadow = words[W_LIVE_BASE], words[W_SHADOW_BASE]
    if words[W_REQUEST_KIND] == REQUEST_LOAD:
        for i in range(words[W_LIVE_LENGTH]):
            words[live + i] = words[shadow + i]
        tick = words[W_REQUEST_TICK]
    else:
        for i in range(words[W_LIVE_LENGTH]):
            words[shadow + i] = words[live + i]
        words[W_REQUEST_TICK] = tick
    store_release(words, W_REQUEST_DONE, number)
    return int(tick)
