"""The scheduler's law: a pure state machine over integers, without clock, socket or plant.

The law exists once, as compiled functions over one int64 array, so that the pacing thread, the
timerfd back end, virtual time and the tests run literally the same code.

A tick passes through two functions::

    advance(law, now_ns)   is the next tick due? how late is it? does the policy move the grid?
    conclude(law, end_ns)  was it an overrun, of which kind? is a limit exceeded? plan the next one

and while paused only through ``hold(law, now_ns)``, which moves the grid but not the tick.

An **overrun** is a tick that ends after its deadline (its planned start plus one period). It is a
``late_wake`` if the delay of its start is the larger part, else a ``long_run``. A tick that
starts late only because its predecessor ended late (*backlog*) does not count as an overrun, unless
its own execution exceeds a period.
"""

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from hilserver.compiled import inlined, kernel
from hilserver.scheduler import faults
from hilserver.scheduler.policies import (
    FAIL,
    STRETCH,
    OverrunLimits,
    OverrunPolicy,
    shift_ns,
)

# Settings
PERIOD, POLICY, CATCH_UP_LIMIT, SINGLE_LIMIT, CONSECUTIVE_LIMIT = range(5)
# The next tick and its planned start
TICK, PLANNED = 5, 6
# The current tick: planned start after the policy, start, delay of the start, deadline
CURRENT, START, LATENCY, DEADLINE, BACKLOG, MISSED, KIND, MARGIN, EXECUTION = range(
    7, 16
)
# Book-keeping
END, WARM_UP_LEFT, CONSECUTIVE, EXECUTED = range(16, 20)
MISSED_TOTAL, SHIFTED_TOTAL, LATE_WAKES, LONG_RUNS = range(20, 24)
# Owned by the loop that drives the law (turn.py)
COMMAND_SEEN, STEPS_DONE, LAST_START, LAST_FAULT = range(24, 28)
N_LAW = 32

_WORDS = types.int64[::1]

WAIT, RUN = 0, 1  # verdicts of `advance`
OK, STOP = 0, -1  # verdicts of `conclude`; the positive ones are codes of `faults`
NO_OVERRUN, LATE_WAKE, LONG_RUN = range(3)
KIND_NAMES = ("none", "late_wake", "long_run")


@kernel(types.void(_WORDS, types.int64))
def begin(law: NDArray[np.int64], planned_ns: int) -> None:
    """Plan the first tick."""
    law[PLANNED] = planned_ns
    law[END] = 0
    law[LAST_START] = 0


@kernel(types.int64(_WORDS, types.int64))
def advance(law: NDArray[np.int64], now_ns: int) -> int:
    """Decide at time `now_ns` [ns] whether the next tick runs; return ``WAIT`` or ``RUN``."""
    planned = law[PLANNED]
    late = now_ns - planned
    if late < 0:
        return WAIT
    period = law[PERIOD]
    law[START] = now_ns
    law[LATENCY] = late
    law[DEADLINE] = planned + period
    law[BACKLOG] = 1 if law[END] > planned else 0
    # During warm-up late ticks mean nothing: the grid moves, and nothing is counted.
    policy = STRETCH if law[WARM_UP_LEFT] > 0 else law[POLICY]
    shift = shift_ns(policy, late, period, law[CATCH_UP_LIMIT])
    law[CURRENT] = planned + shift
    law[MISSED] = 0 if policy == STRETCH else shift // period
    if law[WARM_UP_LEFT] == 0:
        law[MISSED_TOTAL] += law[MISSED]
        law[SHIFTED_TOTAL] += shift
    return RUN


@inlined
def overrun_kind(law: NDArray[np.int64]) -> int:
    """Return which kind of overrun the tick that just ended is, if any."""
    if law[BACKLOG] == 1:
        return LONG_RUN if law[EXECUTION] > law[PERIOD] else NO_OVERRUN
    if law[MARGIN] >= 0:
        return NO_OVERRUN
    return LATE_WAKE if law[LATENCY] >= law[EXECUTION] else LONG_RUN


@kernel(types.int64(_WORDS, types.int64))
def conclude(law: NDArray[np.int64], end_ns: int) -> int:
    """Close the tick that ended at `end_ns` [ns] and plan the next one.

    Returns
    -------
    int
        ``OK``, ``STOP`` (policy ``fail``) or the code in `faults` of the limit that was exceeded.
    """
    law[MARGIN] = law[DEADLINE] - end_ns
    law[EXECUTION] = end_ns - law[START]
    kind = overrun_kind(law)
    law[END] = end_ns
    law[TICK] += 1
    law[EXECUTED] += 1
    law[PLANNED] = law[CURRENT] + law[PERIOD]
    if law[WARM_UP_LEFT] > 0:
        law[WARM_UP_LEFT] -= 1
        law[KIND] = NO_OVERRUN
        return OK
    law[KIND] = kind
    if kind == NO_OVERRUN:
        if law[MARGIN] >= 0:
            law[CONSECUTIVE] = 0
        return OK
    law[LATE_WAKES if kind == LATE_WAKE else LONG_RUNS] += 1
    law[CONSECUTIVE] += 1
    if law[POLICY] == FAIL:
        return STOP
    excess = law[EXECUTION] - law[PERIOD] if law[BACKLOG] == 1 else -law[MARGIN]
    if law[SINGLE_LIMIT] > 0 and excess > law[SINGLE_LIMIT]:
        return faults.SINGLE_OVERRUN
    if law[CONSECUTIVE_LIMIT] > 0 and law[CONSECUTIVE] >= law[CONSECUTIVE_LIMIT]:
        law[CONSECUTIVE] = 0
        return faults.CONSECUTIVE_OVERRUNS
    return OK


@kernel(types.void(_WORDS, types.int64))
def hold(law: NDArray[np.int64], now_ns: int) -> None:
    """Skip the planned starts up to `now_ns` while paused; none counts as missed."""
    late = now_ns - law[PLANNED]
    if late >= 0:
        law[PLANNED] += (late // law[PERIOD] + 1) * law[PERIOD]
    law[END] = 0
    law[LAST_START] = 0


@inlined
def is_due(tick: int, period_ticks: int) -> bool:
    """Return whether a slice runs in `tick`: by count, never by measured time."""
    return bool(tick % period_ticks == 0)


def law_array(
    period_ns: int,
    policy: OverrunPolicy,
    limits: OverrunLimits,
    warm_up_ticks: int = 0,
    first_tick: int = 0,
) -> NDArray[np.int64]:
    """Return the law's state before the first tick, int64 of shape (N_LAW,)."""
    if period_ns <= 0:
        raise ValueError("the base period must be positive")
    law = np.zeros(N_LAW, dtype=np.int64)
    law[PERIOD] = period_ns
    law[POLICY] = policy.code
    law[CATCH_UP_LIMIT] = policy.catch_up_limit_ticks
    law[SINGLE_LIMIT] = limits.single_ns
    law[CONSECUTIVE_LIMIT] = limits.consecutive
    law[WARM_UP_LEFT] = warm_up_ticks
    law[TICK] = first_tick
    return law
