"""Snapshot and restore of all live regions, in one copy between two ticks.

The daemon fills or reads the shadow copy and posts a request; the plant's next latch serves it.
A restart also ends every lease, so that no earlier command continues to act. The live regions are
in one piece, so a request costs one copy of some ten kilobytes.
"""

from typing import Any

from hilserver.compiled import inlined, kernel
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.image import word
from hilserver.image.layout import REQUEST_LOAD, REQUEST_RESTART


@kernel("int64(int64, int64, int64[::1])")
def post_request(kind: int, tick: int, words: Any) -> int:
    """Ask the plant to save its state to the shadow copy, or load it; return the number."""
    words[word.REQUEST_KIND] = kind
    words[word.REQUEST_TICK] = tick
    number = words[word.REQUEST] + 1
    store_release(words, word.REQUEST, number)
    return int(number)


@kernel("boolean(int64, int64[::1])")
def is_done(number: int, words: Any) -> bool:
    """Whether request `number` has been served."""
    return bool(load_acquire(words, word.REQUEST_DONE) >= number)


@inlined
def serve(number: int, tick: int, words: Any) -> int:
    """Serve request `number` if it is pending; return the tick to continue with."""
    if number == words[word.REQUEST_DONE]:
        return tick
    live, shadow = words[word.LIVE_BASE], words[word.SHADOW_BASE]
    if words[word.REQUEST_KIND] in (REQUEST_LOAD, REQUEST_RESTART):
        for i in range(words[word.LIVE_LENGTH]):
            words[live + i] = words[shadow + i]
        tick = words[word.REQUEST_TICK]
    else:
        for i in range(words[word.LIVE_LENGTH]):
            words[shadow + i] = words[live + i]
        words[word.REQUEST_TICK] = tick
    store_release(words, word.REQUEST_DONE, number)
    return int(tick)
