"""Small compiled steps for the tests: what a plant does, without a plant.

Words of the recorded-writes step: 0..9 runs per phase; 20 next row of the schedule; 21 rows;
100.. schedule rows (tick, value as int).
"""

import numpy as np

from hilserver.compiled import kernel
from hilserver.compiled.libc import clock_gettime
from hilserver.scheduler.step import FAULT, LATCH, PUBLISH, STEP_SIGNATURE

LATCHES, PUBLISHES, FAULTS, LAST_FAULT, ORDER, BUSY_TICK, BUSY_NS, JUMP_TO, SHOWN = (
    range(10, 19)
)
NEXT_ROW, N_ROWS, HASH = 20, 21, 22
SCHEDULE = 100
THREAD_CPU_TIME = 3


@kernel(STEP_SIGNATURE)
def counting_step(phase, tick, planned_ns, values, words):
    """Count each phase; slice i counts in words[i], the sum of its ticks in words[50 + i]."""
    if phase == LATCH:
        words[LATCHES] += 1
        if words[JUMP_TO] > 0:
            tick = words[JUMP_TO]
            words[JUMP_TO] = 0
        words[ORDER] = 0
        return tick
    if phase == PUBLISH:
        words[PUBLISHES] += 1
        words[SHOWN] = tick
        words[ORDER] = words[ORDER] * 10 + 9
        return 0
    if phase == FAULT:
        words[FAULTS] += 1
        words[LAST_FAULT] = tick
        return 0
    words[phase] += 1
    words[50 + phase] += tick
    words[ORDER] = words[ORDER] * 10 + phase + 1
    if words[60 + phase] == tick and tick > 0:
        return 7
    return 0


@kernel(STEP_SIGNATURE)
def busy_step(phase, tick, planned_ns, values, words):
    """Burn BUSY_NS of processor time in slice 1 of the tick BUSY_TICK; count faults."""
    if phase == LATCH:
        return tick
    if phase == FAULT:
        words[FAULTS] += 1
        words[LAST_FAULT] = tick
    if phase == 1 and tick == words[BUSY_TICK]:
        scratch = words[30:32]
        clock_gettime(THREAD_CPU_TIME, scratch.ctypes)
        end_ns = scratch[0] * 1_000_000_000 + scratch[1] + words[BUSY_NS]
        while scratch[0] * 1_000_000_000 + scratch[1] < end_ns:
            clock_gettime(THREAD_CPU_TIME, scratch.ctypes)
    return 0


@kernel(STEP_SIGNATURE)
def recorded_writes_step(phase, tick, planned_ns, values, words):
    """Latch scheduled writes at their tick, integrate a stiff pair of states, hash all bits."""
    if phase == LATCH:
        row = words[NEXT_ROW]
        while row < words[N_ROWS] and words[SCHEDULE + 2 * row] <= tick:
            values[words[SCHEDULE + 2 * row + 1] % 4] = (
                words[SCHEDULE + 2 * row + 1] * 1e-3
            )
            row += 1
        words[NEXT_ROW] = row
        return tick
    if phase == 0:
        values[4] += 1e-3 * (values[0] - values[4] + 0.1 * np.sin(values[5]))
        values[5] += 1e-3 * (values[1] * values[4] - values[5])
    elif phase == 1:
        values[6] = 0.9 * values[6] + 0.1 * (values[2] + values[4])
    elif phase == PUBLISH:
        bits = values[:8].view(np.int64)
        for index in range(8):
            words[HASH] = (words[HASH] ^ bits[index]) * 1099511628211
    return 0
