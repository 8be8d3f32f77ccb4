"""One wake-up of the pacing loop, the same in all back ends: command, law, phases, statistics.

Nothing here allocates, waits or needs the interpreter lock. numba's reference counting is off, as
it would cost two atomic operations for each array that a kernel takes from the record.
"""

from typing import Any

import numpy as np
from numba.core import types
from numba.core.types import ExternalFunction, int32, voidptr
from numpy.typing import NDArray

from hilserver.compiled import inlined, kernel, part
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.compiled.libc import monotonic_ns
from hilserver.compiled.records import record_at
from hilserver.scheduler import exchange as ex
from hilserver.scheduler import faults
from hilserver.scheduler import law as lw
from hilserver.scheduler import statistics_rows as rows
from hilserver.scheduler.loop import (
    PREVIOUS,
    RUSAGE,
    S_DUE,
    S_END,
    S_PERIOD_TICKS,
    S_START,
    TURN_ARGUMENTS,
    Loop,
)
from hilserver.scheduler.step import FAULT, LATCH, PUBLISH

# Flags returned by `turn`
RAN, RING, ENDED, STANDING = 1, 2, 4, 8

_RUSAGE_THREAD = 1
_MINOR_FAULTS, _MAJOR_FAULTS, _INVOLUNTARY = 8, 9, 17  # words of struct rusage
_P_CPU, _P_MINOR, _P_MAJOR, _P_INVOLUNTARY = range(4)

getrusage: Any = ExternalFunction("getrusage", int32(int32, voidptr))


@part
def may_run(law: NDArray[np.int64], command: int) -> bool:
    """Return whether `command` allows a tick now."""
    if command == ex.FREE_RUN:
        return True
    if law[lw.COMMAND_SEEN] != command >> 32:
        law[lw.COMMAND_SEEN] = command >> 32
        law[lw.STEPS_DONE] = 0
    return bool(law[lw.STEPS_DONE] < (command & ex.MAX_STEPS))


@inlined
def usage_since_last(scratch: NDArray[np.int64]) -> None:
    """Read the thread's rusage as differences to the previous call."""
    usage = scratch[RUSAGE:PREVIOUS]
    before = scratch[PREVIOUS:]
    getrusage(_RUSAGE_THREAD, usage.ctypes)
    # user and system time, each in seconds and microseconds
    cpu_ns = (usage[0] + usage[2]) * 1_000_000_000 + (usage[1] + usage[3]) * 1000
    now = (cpu_ns, usage[_MINOR_FAULTS], usage[_MAJOR_FAULTS], usage[_INVOLUNTARY])
    for index in range(4):
        usage[index] = now[index] - before[index]
        before[index] = now[index]


@inlined
def write_record(at: Loop, blamed: int, code: int) -> None:
    """Put the tick that just ended into the ring, as an `exchange.OverrunRecord`."""
    law, ring, usage = at.law, at.ring, at.scratch[RUSAGE:PREVIOUS]
    row = ex.next_record(at.control, ring)
    if row < 0:
        return
    record = (
        law[lw.TICK] - 1,
        law[lw.KIND],
        blamed,
        law[lw.START] - law[lw.LATENCY],
        law[lw.LATENCY],
        law[lw.EXECUTION],
        usage[_P_CPU],
        usage[_P_MINOR],
        usage[_P_MAJOR],
        usage[_P_INVOLUNTARY],
        law[lw.MISSED],
        code,
    )
    for index in range(len(record)):
        ring[row, index] = record[index]
    store_release(at.control, ex.RECORDS_MADE, at.control[ex.RECORDS_MADE] + 1)


@inlined
def run_phases(step: Any, at: Loop, now_ns: int) -> int:
    """Run LATCH, the due slices and PUBLISH; return the first fault number, 0 if none.

    The first due slice includes the time of LATCH, the last that of PUBLISH: the slices'
    executions add up to the tick's.
    """
    law, slices, values, words = at.law, at.slices, at.values, at.words
    planned = law[lw.CURRENT]
    law[lw.TICK] = step(LATCH, law[lw.TICK], planned, values, words)
    tick = law[lw.TICK]
    fault, start, last = 0, now_ns, -1
    for index in range(slices.shape[0]):
        due = lw.is_due(tick, slices[index, S_PERIOD_TICKS])
        slices[index, S_DUE] = due
        if due:
            answer = step(index, tick, planned, values, words)
            if fault == 0:
                fault = answer
            slices[index, S_START] = start
            start = monotonic_ns(at.scratch)
            slices[index, S_END] = start
            last = index
    step(PUBLISH, tick, planned, values, words)
    if last >= 0:
        slices[last, S_END] = monotonic_ns(at.scratch)
    return fault


@inlined
def blame(kind: int, slices: NDArray[np.int64]) -> int:
    """Return the due slice to which an overrun counts: the first, or the longest of a long run."""
    blamed, longest = 0, -1
    for index in range(slices.shape[0]):
        if slices[index, S_DUE] == 1:
            execution = slices[index, S_END] - slices[index, S_START]
            if longest < 0 or (kind == lw.LONG_RUN and execution > longest):
                blamed, longest = index, execution
    return blamed


@inlined
def count(at: Loop, now_ns: int, blamed: int) -> None:
    """Count the tick that began at the real time `now_ns` in the statistics."""
    law, slices, stats = at.law, at.slices, at.stats
    since_last = now_ns - law[lw.LAST_START] if law[lw.LAST_START] > 0 else 0
    law[lw.LAST_START] = now_ns
    latency = law[lw.LATENCY]
    rows.record_tick(stats, latency, since_last, law[lw.MISSED])
    for index in range(slices.shape[0]):
        place = rows.N_HEAD + index * rows.N_ROW
        row = record_at(stats, place, rows.ROW)
        row.missed_carry += law[lw.MISSED]
        if slices[index, S_DUE] == 0:
            continue
        missed = row.missed_carry // slices[index, S_PERIOD_TICKS]
        row.missed_carry -= missed * slices[index, S_PERIOD_TICKS]
        start, end = slices[index, S_START], slices[index, S_END]
        rows.record_run(
            stats,
            place,
            law[lw.TICK] - 1,
            start,
            latency + start - now_ns,
            end - start,
            law[lw.DEADLINE] - law[lw.START] - (end - now_ns),
            law[lw.KIND] if index == blamed else lw.NO_OVERRUN,
            missed,
        )


@inlined
def stand_still(step: Any, at: Loop, command: int, now_ns: int) -> int:
    """Run no tick, but publish a state that was restored meanwhile at once."""
    law, control = at.law, at.control
    tick = step(LATCH, law[lw.TICK], law[lw.PLANNED], at.values, at.words)
    if tick != law[lw.TICK]:
        step(PUBLISH, max(tick - 1, 0), law[lw.PLANNED], at.values, at.words)
    law[lw.TICK] = tick
    store_release(control, ex.NEXT_TICK, tick)
    lw.hold(law, now_ns)
    news = load_acquire(control, ex.ACKNOWLEDGED) != command
    store_release(control, ex.ACKNOWLEDGED, command)
    return STANDING | (RING if news else 0)


@inlined
def report_fault(step: Any, at: Loop, fault: int, verdict: int, blamed: int) -> None:
    """Enter the safe state if a slice or the law requests it; record overruns and new faults."""
    law, code = at.law, verdict
    if fault > 0 and verdict == lw.OK:
        code = faults.SLICE + fault
    if code > 0:
        step(FAULT, code, law[lw.CURRENT], at.values, at.words)
    if law[lw.KIND] != lw.NO_OVERRUN or code not in (0, law[lw.LAST_FAULT]):
        write_record(at, blamed, code)
    law[lw.LAST_FAULT] = code if code >= faults.SLICE else 0


@inlined
def announce_due(comm: NDArray[np.int64], tick: int, planned_ns: int) -> int:
    """Announce the communication slices that are due; return ``RING`` if any is."""
    flags = 0
    for row in range(comm.shape[0] // ex.N_COMM):
        if lw.is_due(tick, comm[row * ex.N_COMM + ex.COMM_PERIOD_TICKS]):
            ex.announce(comm, row, tick, planned_ns)
            flags = RING
    return flags


@kernel(types.int64(*TURN_ARGUMENTS, types.boolean), _nrt=False)
def turn(step: Any, at: Loop, virtual: bool) -> int:
    """Do what is due now.

    Returns
    -------
    int
        ``RAN | RING | ENDED | STANDING``.
    """
    law, control = at.law, at.control
    real_ns = monotonic_ns(at.scratch)
    now_ns = law[lw.PLANNED] if virtual else real_ns
    store_release(control, ex.HEARTBEAT, real_ns)
    law[lw.PERIOD] = load_acquire(control, ex.PACED_PERIOD)
    command = load_acquire(control, ex.COMMAND)
    if not may_run(law, command):
        # Virtual time stands as well: the next tick keeps its planned start, and no lease ages.
        return int(stand_still(step, at, command, now_ns - 1 if virtual else now_ns))
    if lw.advance(law, now_ns) == lw.WAIT:
        return 0

    counted = law[lw.WARM_UP_LEFT] == 0
    fault = run_phases(step, at, real_ns)
    tick = law[lw.TICK]
    verdict = lw.conclude(law, now_ns if virtual else monotonic_ns(at.scratch))
    law[lw.STEPS_DONE] += 1
    blamed = blame(law[lw.KIND], at.slices)
    if counted:
        count(at, real_ns, blamed)
    usage_since_last(at.scratch)
    report_fault(step, at, fault, verdict, blamed)
    flags = RAN | int(announce_due(at.comm, tick, law[lw.CURRENT]))
    store_release(control, ex.NEXT_TICK, law[lw.TICK])
    store_release(control, ex.TICKS_DONE, law[lw.EXECUTED])
    if command != ex.FREE_RUN and not may_run(law, command):
        store_release(control, ex.ACKNOWLEDGED, command)
        flags |= RING
    if verdict == lw.STOP:
        flags |= ENDED | RING
    return flags
