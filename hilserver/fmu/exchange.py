"""An FMU in a process of its own: what the plant requests at a slice, what the child answers.

Requests are numbered. The plant takes the last answer and posts the next request in the same run:
outputs are one slice old, and it never waits, even when it catches up itself and leaves the child
no time; such slices are counted separately. Until an answer arrives the outputs hold, and the
slices that pass are owed: the next request covers all of them. The number of late slices is the
block's last output and an input of a replay, in which the same slices are late.

Its silence is wall time: a late run adds the time since the run before, but at most the length of a
slice at speed 1, since a standstill of the whole computer is none. At speed 0.01 a limit of 0.1 s
is therefore reached after 10 s of wall time, at speed 100 after 10 s of simulated time.

The child stores its state after every request, in two places alternately: the state before the
current request is complete when a snapshot is taken.
"""

from typing import Any

import numpy as np
from numba import carray, float64, int64

import hilserver.fmu.layout as at
from hilserver.compiled import kernel
from hilserver.compiled.atomics import load_acquire, store_release
from hilserver.compiled.foreign import words_at
from hilserver.compiled.libc import monotonic_ns, ring_doorbell, sleep_until
from hilserver.fmu.calls import F8, I8, KEEP, STEP, advance, give_up, restore, store

WHOLE_SLICE = 0.9  # a child given less than this share of a slice was hurried
WAIT_NS, NAP_NS, LOOKS = 10_000_000_000, 20_000, 2000
"""In virtual time: the longest wait, the sleep between two looks, looks before sleeping."""


@kernel()
def _shared(a: Any) -> Any:
    return carray(words_at(a[at.A_SHARED]), (a[at.A_SHARED_LENGTH],))


@kernel()
def _store(number: int, u: Any, y: Any, x: Any, p: Any, s: Any) -> Any:
    """Return one of the four states in the shared words: number of bytes, bytes."""
    length = x.shape[0] - at.X_BYTES
    begin = at.N_SHARED + u.shape[0] + p.shape[0] + y.shape[0] + number * length
    return s[begin : begin + length]


@kernel()
def _copy_numbers(source: Any, target: Any) -> None:
    for i in range(target.shape[0]):
        target[i] = source[i]


@kernel()
def _post(
    steps: int, pending: int, loads: bool, u: Any, p: Any, a: Any, s: Any
) -> None:
    number = s[at.S_ASKED] + 1
    numbers = s[at.N_SHARED :].view(np.float64)
    _copy_numbers(u, numbers[: u.shape[0]])
    _copy_numbers(p, numbers[u.shape[0] : u.shape[0] + p.shape[0]])
    s[at.S_STEPS], s[at.S_PENDING] = steps, pending
    if loads:
        s[at.S_LOAD] = number
    store_release(s, at.S_ASKED, number)
    a[at.A_SILENT] = 0
    ring_doorbell(a[at.A_BELL], a[at.A_ONE :])


@kernel()
def _wait(a: Any, s: Any) -> None:
    """Let simulated time wait for the child."""
    limit_ns = monotonic_ns(a[at.A_TIMESPEC :]) + WAIT_NS
    for look in range(WAIT_NS // NAP_NS):
        if (
            load_acquire(s, at.S_DONE) == s[at.S_ASKED]
            or load_acquire(a, at.A_DEAD) != 0
        ):
            return
        if look > LOOKS:
            now_ns = monotonic_ns(a[at.A_TIMESPEC :])
            if now_ns > limit_ns:
                return
            sleep_until(now_ns + NAP_NS, a[at.A_TIMESPEC :])


@kernel(STEP)
def run_beside(tick: int, dt_s: float, u: Any, y: Any, x: Any, p: Any, a: Any) -> int:  # noqa: ARG001
    """Show the child's answer and ask it for the next slice."""
    if x[at.X_FAILED] != 0.0:
        return 0
    s, n = _shared(a), y.shape[0] - 1
    was_late = abs(y[n]) > x[at.X_LATE]  # late in the run that is replayed
    slice_ns, now_ns = int(dt_s * 1e9), monotonic_ns(a[at.A_TIMESPEC :])
    had_ns, a[at.A_RAN] = now_ns - a[at.A_RAN], now_ns
    if a[at.A_WAITS] != 0 and not was_late:
        _wait(a, s)
    if was_late or a[at.A_DEAD] != 0 or load_acquire(s, at.S_DONE) != s[at.S_ASKED]:
        x[at.X_OWED] += 1.0
        x[at.X_LATE] += 1.0
        a[at.A_LATE] += 1
        a[at.A_HURRIED] += 1 if had_ns < WHOLE_SLICE * slice_ns else 0
        a[at.A_SILENT] += min(had_ns, slice_ns)
        ends = a[at.A_DEAD] != 0 or a[at.A_SILENT] >= a[at.A_LIMIT]
        if was_late:
            ends = y[n] < 0.0
        y[n] = -x[at.X_LATE] if ends else x[at.X_LATE]
        if not ends:
            return 0
        give_up(at.SILENT, y[:n], x, a)
        return at.SILENT
    status = s[at.S_STATUS]
    if status > at.WARNING:
        give_up(status, y[:n], x, a)
        return int(status)
    outputs = s[at.N_SHARED + u.shape[0] + p.shape[0] :].view(np.float64)
    _copy_numbers(outputs, y[:n])
    x[at.X_STEPS] += x[at.X_PENDING]
    x[at.X_PENDING], x[at.X_OWED] = 1.0 + x[at.X_OWED], 0.0
    _post(int(x[at.X_STEPS]), int(x[at.X_PENDING]), False, u, p, a, s)
    return 0


@kernel(KEEP)
def keep_beside(u: Any, y: Any, x: Any, p: Any, a: Any) -> None:
    """Take the state before the current request, for the snapshot that follows."""
    s = _shared(a)
    if a[at.A_CAPACITY] != 0 and s[at.S_LOAD] != s[at.S_ASKED]:
        words = x.view(np.int64)
        _copy_numbers(
            _store((s[at.S_ASKED] - 1) & 1, u, y[:-1], x, p, s), words[at.X_BYTES :]
        )


@kernel(KEEP)
def adopt_beside(u: Any, y: Any, x: Any, p: Any, a: Any) -> None:
    """Let the child continue from `x`, which was just restored."""
    s = _shared(a)
    if a[at.A_CAPACITY] == 0:
        a[at.A_SILENT] = 0
        x[at.X_STEPS], x[at.X_PENDING] = s[at.S_STEPS], s[at.S_PENDING]
        x[at.X_FAILED] = 1.0 if a[at.A_STATUS] else 0.0
        return
    words = x.view(np.int64)
    _copy_numbers(
        words[at.X_BYTES :], _store(2 + ((s[at.S_ASKED] + 1) & 1), u, y[:-1], x, p, s)
    )
    a[at.A_STATUS] = 0
    _post(int(x[at.X_STEPS]), int(x[at.X_PENDING]), True, u, p, a, s)


@kernel(int64(I8, F8, F8, F8, F8, I8, float64))
def answer(s: Any, u: Any, y: Any, x: Any, p: Any, a: Any, dt_s: float) -> int:
    """Do what was requested, in the child; return 1 if anything was.

    Parameters
    ----------
    s : ndarray of int64
        The shared words.
    u, y, x, p, a
        The child's own arrays, as for a step.
    dt_s : float
        Slice [s].
    """
    number = load_acquire(s, at.S_ASKED)
    loads = s[at.S_LOAD] == number
    if number == s[at.S_DONE] or (s[at.S_CURRENT] == 0 and not loads):
        return 0  # nothing new, or the request was for an earlier child
    numbers = s[at.N_SHARED :].view(np.float64)
    _copy_numbers(numbers, u)
    _copy_numbers(numbers[u.shape[0] :], p)
    status, stores = at.OK, a[at.A_CAPACITY] != 0
    x[at.X_STEPS], n = s[at.S_STEPS], s[at.S_PENDING]
    if loads and stores:
        _copy_numbers(
            _store(2 + (number & 1), u, y, x, p, s), x.view(np.int64)[at.X_BYTES :]
        )
        status = restore(x, a)
    s[at.S_CURRENT] = 1
    if status <= at.WARNING:
        status = advance(n, dt_s, u, y, x, p, a)
    if status <= at.WARNING and stores:
        status = store(x, a)
        _copy_numbers(x.view(np.int64)[at.X_BYTES :], _store(number & 1, u, y, x, p, s))
    _copy_numbers(
        y, numbers[u.shape[0] + p.shape[0] : u.shape[0] + p.shape[0] + y.shape[0]]
    )
    s[at.S_STATUS] = status
    store_release(s, at.S_DONE, number)
    return 1
