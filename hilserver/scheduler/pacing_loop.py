"""The compiled loops: of the `thread` back end, and for a batch of ticks in virtual time."""

from typing import Any

from numba.core import types

from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.compiled.libc import monotonic_ns, ring_doorbell, sleep_until
from hilserver.scheduler import exchange as ex
from hilserver.scheduler import law as lw
from hilserver.scheduler.loop import ONE, TURN_ARGUMENTS, Loop
from hilserver.scheduler.turn import ENDED, RAN, RING, turn

LONGEST_SLEEP_NS = 50_000_000  # the loop looks at its control words at least this often


@kernel(types.int64(*TURN_ARGUMENTS, types.int32), _nrt=False)
def pace(step: Any, at: Loop, doorbell: int) -> int:
    """Pace ticks by absolute deadlines until a stop is requested or the policy ends the run.

    Parameters are those of `turn`, and `doorbell`: the eventfd rung for the event loop.

    Returns
    -------
    int
        1 if the policy ``fail`` ended the run, otherwise 0.
    """
    law, control, scratch = at.law, at.control, at.scratch
    scratch[ONE] = 1
    one = scratch[ONE : ONE + 1]
    now_ns = monotonic_ns(scratch)
    lw.begin(law, now_ns + law[lw.PERIOD])
    while load_acquire(control, ex.STOP_REQUEST) == 0:
        now_ns = monotonic_ns(scratch)
        if law[lw.PLANNED] - now_ns > LONGEST_SLEEP_NS:
            store_release(control, ex.HEARTBEAT, now_ns)
            sleep_until(now_ns + LONGEST_SLEEP_NS, scratch)
            continue
        sleep_until(law[lw.PLANNED], scratch)
        flags = turn(step, at, False)
        if flags & RING:
            ring_doorbell(doorbell, one)
        if flags & ENDED:
            return 1
    return 0


@kernel(types.int64(*TURN_ARGUMENTS, types.int64), _nrt=False)
def run_batch(step: Any, at: Loop, n_ticks: int) -> int:
    """Run at most `n_ticks`; return early, with the flags of `turn`, when there is news."""
    flags = 0
    for _ in range(n_ticks):
        flags = turn(step, at, True)
        if flags != RAN:
            break
    return flags
