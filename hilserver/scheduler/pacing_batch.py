"""A batch of ticks in virtual time."""

from typing import Any

from numba.core import types

from hilserver.compiled import kernel
from hilserver.scheduler.loop import TURN_ARGUMENTS, Loop
from hilserver.scheduler.turn import RAN, turn


@kernel(types.int64(*TURN_ARGUMENTS, types.int64))
def run_batch(step: Any, at: Loop, n_ticks: int) -> int:
    """Run at most `n_ticks`; return early, with the flags of `turn`, when there is news."""
    flags = 0
    for _ in range(n_ticks):
        flags = turn(step, at, True)
        if flags != RAN:
            break
    return flags
