"""An FMU called from compiled code: numbers in, a step, numbers out, its state kept and restored.

Nothing here uses Python; what the FMU does within a call is beyond our control.
"""

import math
from typing import Any, Final

import numpy as np
from numba import float64, int64, void

import hilserver.fmu.layout as at
from hilserver.compiled import kernel
from hilserver.compiled.foreign import ask
from hilserver.compiled.libc import monotonic_ns

F8, I8 = float64[::1], int64[::1]
STEP: Final = int64(int64, float64, F8, F8, F8, F8, I8)
"""``(tick, dt_s, u, y, x, p, a)``; returns 0, or (once) what went wrong."""
KEEP: Final = void(F8, F8, F8, F8, I8)  # ``(u, y, x, p, a)``, between two ticks
EXACT: Final = 2.0**53  # integers up to here are float64 without loss


@kernel(int64(int64))
def _place(row: int) -> int:
    """Return the index of a row in `a`."""
    return at.ROWS + row * at.CALL_WORDS


@kernel()
def _encode(values: Any, kind: int, size: int, out: Any) -> None:
    """Write numbers in an FMU's own type, one after another."""
    signed = 1 if kind == at.SIGNED else 0
    high = min(2.0 ** (8 * size - signed) - 1.0, EXACT)
    low = -high - 1.0 if kind == at.SIGNED else 0.0
    singles, octets = out.view(np.float32), out.view(np.uint8)
    for i in range(values.shape[0]):
        value = values[i]
        if kind == at.FLOAT:
            singles[i] = value
            continue
        if kind == at.BOOLEAN:
            whole = 1 if value != 0.0 else 0
        elif math.isnan(value):
            whole = 0
        else:
            whole = int(min(max(math.floor(value + 0.5), low), high))
        for k in range(size):
            octets[i * size + k] = (whole >> (8 * k)) & 255


@kernel()
def _decode(raw: Any, kind: int, size: int, values: Any) -> None:
    """Read numbers that an FMU wrote in its own type."""
    singles, octets = raw.view(np.float32), raw.view(np.uint8)
    for i in range(values.shape[0]):
        if kind == at.FLOAT:
            values[i] = singles[i]
            continue
        whole = 0
        for k in range(size):
            whole |= int(octets[i * size + k]) << (8 * k)
        if kind == at.SIGNED and size < 8 and whole >> (8 * size - 1):
            whole -= 1 << (8 * size)
        values[i] = whole


@kernel()
def access(first: int, n_rows: int, values: Any, a: Any, gets: bool) -> int:
    """Get or set the variables of some rows, one call per row; return the worst status."""
    worst, begin = 0, 0
    for row in range(first, first + n_rows):
        r = _place(row)
        n, kind, size = a[r + at.R_COUNT], a[r + at.R_KIND], a[r + at.R_BYTES]
        piece, scratch = values[begin : begin + n], a[a[at.A_SCRATCH] :]
        converts = kind != at.FLOAT or size != 8
        if converts and not gets:
            _encode(piece, kind, size, scratch)
        data = scratch.ctypes.data if converts else piece.ctypes.data
        references, m = a[a[r + at.R_REFERENCES] :].ctypes.data, a[r + at.R_VARIABLES]
        # FMI 3.0 alone takes the number of values; 2.0 ignores a further argument.
        status = ask(
            a[r + at.R_FUNCTION], a[at.A_INSTANCE], references, m, data, n, 0, 0.0, 0.0
        )
        if converts and gets:
            _decode(scratch, kind, size, piece)
        worst, begin = max(worst, status), begin + n
    return int(worst)


@kernel()
def _do_step(time_s: float, dt_s: float, a: Any) -> int:
    instance = a[at.A_INSTANCE]
    if a[at.A_VERSION] == 2:
        return int(ask(a[at.A_DO_STEP], instance, 0, 0, 0, 0, 0, time_s, dt_s))
    a[at.A_EVENT] = a[at.A_TERMINATE] = a[at.A_EARLY] = 0
    status = ask(
        a[at.A_DO_STEP],
        instance,
        0,
        a[at.A_EVENT :].ctypes.data,
        a[at.A_TERMINATE :].ctypes.data,
        a[at.A_EARLY :].ctypes.data,
        a[at.A_LAST_TIME :].ctypes.data,
        time_s,
        dt_s,
    )
    # An FMU writes a C bool into each word, one byte.
    if status <= at.WARNING and a[at.A_EVENT] & 255:
        return at.EVENT_NEEDED
    if status <= at.WARNING and a[at.A_TERMINATE] & 255:
        return at.TERMINATED
    return int(status)


@kernel()
def _changed(p: Any, a: Any) -> bool:
    """Whether a parameter differs, bit by bit, from what was last set; if so, note it."""
    known, now = a[a[at.A_KNOWN] :], p.view(np.int64)
    changed = a[at.A_FRESH] != 0
    a[at.A_FRESH] = 0
    for i in range(now.shape[0]):
        changed |= known[i] != now[i]
        known[i] = now[i]
    return bool(changed)


@kernel()
def advance(n: int, dt_s: float, u: Any, y: Any, x: Any, p: Any, a: Any) -> int:
    """Set the inputs, do `n` steps, get the outputs; return the worst status.

    With `n` = 0 the inputs stay unchanged too, so the outputs are those of the state.
    """
    n_in, n_p, n_out = a[at.A_INPUTS], a[at.A_PARAMETERS], a[at.A_OUTPUTS]
    worst = access(0, n_in, u, a, gets=False) if n > 0 else at.OK
    if n > 0 and _changed(p, a):
        worst = max(worst, access(n_in, n_p, p, a, gets=False))
    for _ in range(n):
        if worst > at.WARNING:
            return int(worst)
        worst = max(worst, _do_step(x[at.X_STEPS] * dt_s, dt_s, a))
        x[at.X_STEPS] += 1.0
        a[at.A_STEPS] = int(x[at.X_STEPS])
    if worst <= at.WARNING:
        worst = max(worst, access(n_in + n_p, n_out, y, a, gets=True))
    return int(worst)


@kernel()
def store(x: Any, a: Any) -> int:
    """Let the FMU write its state to `x`; return the worst status."""
    state, size = a[at.A_STATE :].ctypes.data, a[at.A_SIZE :].ctypes.data
    instance, bytes_ = a[at.A_INSTANCE], x[at.X_STATE :].ctypes.data
    status = ask(a[at.A_GET_STATE], instance, state, 0, 0, 0, 0, 0.0, 0.0)
    if status > at.WARNING:
        return int(status)
    status = ask(a[at.A_STATE_SIZE], instance, a[at.A_STATE], size, 0, 0, 0, 0.0, 0.0)
    if status > at.WARNING:
        return int(status)
    if not 0 <= a[at.A_SIZE] <= a[at.A_CAPACITY]:
        return at.STATE_TOO_LARGE
    x[at.X_BYTES] = a[at.A_SIZE]
    return int(
        ask(
            a[at.A_SERIALIZE],
            instance,
            a[at.A_STATE],
            bytes_,
            a[at.A_SIZE],
            0,
            0,
            0.0,
            0.0,
        )
    )


@kernel()
def restore(x: Any, a: Any) -> int:
    """Let the FMU continue from the state in `x`; return the worst status."""
    size = x[at.X_BYTES]
    if not 0.0 <= size <= a[at.A_CAPACITY]:
        return at.STATE_UNFIT
    a[at.A_FRESH] = 1
    instance, state = a[at.A_INSTANCE], a[at.A_STATE :].ctypes.data
    bytes_ = x[at.X_STATE :].ctypes.data
    if a[at.A_STATE] != 0:
        ask(a[at.A_FREE_STATE], instance, state, 0, 0, 0, 0, 0.0, 0.0)
        a[at.A_STATE] = 0
    status = ask(
        a[at.A_DESERIALIZE], instance, bytes_, int(size), state, 0, 0, 0.0, 0.0
    )
    if status > at.WARNING:
        return int(status)
    return int(ask(a[at.A_SET_STATE], instance, a[at.A_STATE], 0, 0, 0, 0, 0.0, 0.0))


@kernel()
def give_up(status: int, y: Any, x: Any, a: Any) -> None:
    """Show no numbers until another state is restored."""
    x[at.X_FAILED] = 1.0
    if a[at.A_STATUS] == 0:
        a[at.A_STATUS] = status
    for i in range(y.shape[0]):
        y[i] = math.nan


@kernel(STEP)
def run_here(tick: int, dt_s: float, u: Any, y: Any, x: Any, p: Any, a: Any) -> int:
    """Do one step in this thread; a fault is returned once, the outputs stay Bad."""
    if x[at.X_FAILED] != 0.0:
        return 0
    began_ns = monotonic_ns(a[at.A_TIMESPEC :])
    a[at.A_SINCE] = began_ns
    status = advance(1, dt_s, u, y, x, p, a)
    a[at.A_SINCE] = 0
    took_ns = monotonic_ns(a[at.A_TIMESPEC :]) - began_ns
    if took_ns > a[at.A_SLOW]:
        place = at.N_HEAD + 2 * (a[at.A_NOTED] % at.SLOW_CALLS)
        a[place], a[place + 1] = tick, took_ns
        a[at.A_NOTED] += 1
    if status <= at.WARNING:
        return 0
    give_up(status, y, x, a)
    return int(status)


@kernel(KEEP)
def keep_here(u: Any, y: Any, x: Any, p: Any, a: Any) -> None:  # noqa: ARG001
    """Write the state to `x`, for the snapshot that follows."""
    if a[at.A_GET_STATE] != 0 and x[at.X_FAILED] == 0.0:
        status = store(x, a)
        if status > at.WARNING:
            x[at.X_BYTES] = -1.0


@kernel(KEEP)
def adopt_here(u: Any, y: Any, x: Any, p: Any, a: Any) -> None:  # noqa: ARG001
    """Continue from `x`, which was just restored."""
    a[at.A_FRESH] = 1
    if a[at.A_GET_STATE] == 0:
        x[at.X_STEPS], x[at.X_FAILED] = a[at.A_STEPS], 1.0 if a[at.A_STATUS] else 0.0
        return
    a[at.A_STATUS] = 0
    status = restore(x, a)
    if status > at.WARNING:
        x[at.X_FAILED], a[at.A_STATUS] = 1.0, status
