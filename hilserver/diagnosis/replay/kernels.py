"""Compiled free runs of the daemon's own drive over whole logs; the rest is in `pose_kernels`.

Segments lie one after the other in all arrays: segment i covers the rows ``first[i]`` to
``first[i + 1] - 1``, one row per plant tick.
"""

from typing import Any

import numpy as np

from hilserver.compiled import kernel
from hilserver.compiled.records import assign, record_at
from hilserver.plant.command import command
from hilserver.plant.drive import (
    drive_base,
    drive_terms,
    encoder,
    load,
    process_of_tick,
)
from hilserver.plant.layout import INPUTS, Inputs, Outputs, Parameters, State

SETPOINT = Inputs.where("setpoint").start


@kernel()
def run_drive(
    p: Parameters,
    x0: State,
    x: State,
    first: Any,
    inputs: Any,
    input_row: Any,
    volts: Any,
    speed_0: Any,
    phase_ticks: float,
    y: Outputs,
    speed: Any,
    seen: Any,
    duty: Any,
) -> None:
    """Run the whole chain from set-points, cut point A: steps 1 to 6 of the plant's tick.

    Parameters
    ----------
    x0, x
        State before each segment; one as working memory.
    inputs : ndarray, shape (rows, Inputs.n_words)
        Distinct inputs; ``input_row[k]`` is the row latched at tick k.
    volts : ndarray, shape (ticks,)
        Battery voltage.
    speed_0 : ndarray, shape (segments, 4)
        Wheel speeds [rpm] with which each segment starts, in balance.
    speed, seen, duty : ndarray, shape (ticks, 4)
        Output: true speed, speed as the encoder shows it, duty.
    """
    for s in range(first.size - 1):
        assign(x, x0)
        x.control_phase = phase_ticks
        _set_start(p, x, speed_0[s])
        for k in range(first[s], first[s + 1]):
            x.battery_v = volts[k]
            for i in range(4):
                speed[k, i] = x.speed[i]
            command(p, x, _row(inputs, input_row[k]))
            if p.drive_terms != 0.0:
                drive_terms(p, x, y)
            else:
                drive_base(p, x, y)
            for i in range(4):
                seen[k, i] = y.speed[i]
                duty[k, i] = y.duty[i]


@kernel()
def _row(inputs: Any, k: int) -> Inputs:
    return record_at(inputs, k * inputs.shape[1], INPUTS)  # type: ignore[no-any-return]


@kernel()
def _set_start(p: Parameters, x: State, speed_0: Any) -> None:
    """Let the wheels turn in balance: shape (8,), shown speeds [rpm] and integrals."""
    for i in range(4):
        turns = speed_0[i] / p.encoder_gain[i]
        x.speed[i] = turns
        x.motor[i] = turns
        x.setpoint[i] = speed_0[i]
        x.integral[i] = speed_0[4 + i] / p.encoder_gain[i]
        x.encoder[i] = (1.0 - p.encoder_share) * turns


@kernel()
def _drive_to(
    p: Parameters, x: State, y: Outputs, inputs: Any, first: int, end: int
) -> None:
    for k in range(first, end):
        command(p, x, _row(inputs, k))
        drive_terms(p, x, y)


@kernel()
def _miss(p: Parameters, y: Outputs, measured: Any, i: int) -> float:
    """Return the squared difference between a wheel and its measurement [rpm^2]."""
    speed = y.speed[i] - measured[i]
    duty = (y.duty[i] - measured[4 + i]) / max(p.k_p, 1e-9)
    return (0.0 if np.isnan(speed) else speed * speed) + (
        0.0 if np.isnan(duty) else duty * duty
    )


@kernel()
def _place(
    p: Parameters,
    x: State,
    trial: State,
    y: Outputs,
    inputs: Any,
    first: int,
    at: int,
    measured: Any,
) -> None:
    """Place the change that is in row `at` at one of the ticks `first` to `at`.

    Wheels are placed independently, as long as nothing but their own set-points changes.
    """
    before, after = inputs[first - 1].copy(), inputs[at].copy()
    alone = True
    for c in range(after.size):
        if before[c] != after[c] and not SETPOINT <= c < SETPOINT + 4:
            alone = False
    least, best, miss = np.full(4, np.inf), np.full(4, at), np.empty(4)
    for change in range(at, first - 1, -1):
        inputs[change:at] = after
        assign(trial, x)
        _drive_to(p, trial, y, inputs, first, at + 1)
        for i in range(4):
            miss[i] = _miss(p, y, measured, i)
        if not alone:
            miss[:] = miss.sum()
        for i in range(4):
            if miss[i] < least[i]:
                least[i], best[i] = miss[i], change
    inputs[first:at] = before
    if not alone:
        inputs[best[0] : at] = after
        return
    for i in range(4):
        inputs[best[i] : at, SETPOINT + i] = after[SETPOINT + i]


@kernel()
def place_inputs(
    p: Parameters,
    x0: State,
    x: State,
    trial: State,
    first: Any,
    inputs: Any,
    speed_0: Any,
    is_row: Any,
    measured: Any,
    y: Outputs,
) -> None:
    """Move changes of the inputs to the ticks at which they fit the measured wheels best.

    A table shows that an input changed between two rows, but not at which tick. The wheels respond
    within milliseconds, so their values in the first row with the new input reveal it.

    Parameters
    ----------
    x0, x, trial
        State before each segment; two as working memory.
    inputs : ndarray, shape (ticks, Inputs.n_words)
        Changed in place: first a change is in its row, afterwards at its own tick.
    speed_0
        As for `run_drive`.
    is_row : ndarray of bool, shape (ticks,)
        Which ticks have a row of the table.
    measured : ndarray, shape (ticks, 8)
        Speeds [rpm] and duties [%] in the rows, NaN where there are none.
    """
    for s in range(first.size - 1):
        assign(x, x0)
        _set_start(p, x, speed_0[s])
        k = first[s]
        while k < first[s + 1]:
            at = k
            while at < first[s + 1] - 1 and not is_row[at]:
                at += 1
            if first[s] < k < at and (inputs[at] != inputs[k - 1]).any():
                _place(p, x, trial, y, inputs, k, at, measured[at])
            _drive_to(p, x, y, inputs, k, at + 1)
            k = at + 1


@kernel()
def run_process(
    p: Parameters,
    x0: State,
    x: State,
    first: Any,
    duty: Any,
    volts: Any,
    speed_0: Any,
    seen: Any,
) -> None:
    """Run process and encoder alone under a given duty, cut point B.

    Parameters
    ----------
    duty : ndarray, shape (ticks, 4)
        Of the controller; friction and dead zone, if the plant has them, come after it.
    x0, x, volts, speed_0
        As for `run_drive`.
    seen : ndarray, shape (ticks, 4)
        Output: speed as the encoder shows it.
    """
    for s in range(first.size - 1):
        assign(x, x0)
        for i in range(4):
            x.speed[i] = speed_0[s, i]
            x.motor[i] = speed_0[s, i]
        for k in range(first[s], first[s + 1]):
            a00, a01, a10, a11, b0, b1 = process_of_tick(p, volts[k])
            for i in range(4):
                motor, n = x.motor[i], x.speed[i]
                seen[k, i] = encoder(p, x, i)
                u = load(p, i, duty[k, i], n)
                x.motor[i] = a00 * motor + a01 * n + b0 * u
                x.speed[i] = a10 * motor + a11 * n + b1 * u


@kernel()
def sample(dense: Any, column: int, low: Any, high: Any, at: Any, out: Any) -> None:
    """Read a dense column between ticks, held at the ends of the segment.

    ``at`` is the row as a fraction; ``low`` and ``high`` are the first and last row of the sample's
    segment.
    """
    for j in range(at.size):
        where = min(max(at[j], float(low[j])), float(high[j]))
        k = int(where)
        share = where - k
        value = dense[k, column]
        if share > 0.0:
            value += share * (dense[k + 1, column] - value)
        out[j] = value
