"""Compiled free runs of the daemon's own plant over whole logs.

Segments lie one after the other in all arrays: segment i covers the rows ``first[i]`` to
``first[i + 1] - 1``, one row per plant tick.
"""

from typing import Any

import numpy as np

from hilserver.compiled import kernel
from hilserver.compiled.records import assign, record_at
from hilserver.plant.command import command
from hilserver.plant.drive import drive_base, drive_terms, encoder, load, process_of_tick
from hilserver.plant.kinematics import (
    across,
    in_region,
    of_speeds,
    sideways,
    speeds_suffice,
    velocity_terms,
)
from hilserver.plant.layout import INPUTS, Inputs, Outputs, Parameters, State
from hilserver.plant.nav import shown_position, shown_yaw
from hilserver.plant.pose import shift, turn, wrap
from hilserver.plant.robot import SIDE, drive_on_with_terms, follow_wheels

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
        State before each segment; one to compute with.
    inputs : ndarray, shape (rows, Inputs.n_words)
        Distinct inputs; ``input_row[k]`` is the row that is latched at tick k.
    volts : ndarray, shape (ticks,)
        Battery voltage.
    speed_0 : ndarray, shape (segments, 4)
        Wheel speeds [rpm] that each segment starts with, in balance.
    speed, seen, duty : ndarray, shape (ticks, 4)
        Written: true speed, speed as the encoder shows it, duty.
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
def _drive_to(p: Parameters, x: State, y: Outputs, inputs: Any, first: int, end: int) -> None:
    for k in range(first, end):
        command(p, x, _row(inputs, k))
        drive_terms(p, x, y)


@kernel()
def _miss(p: Parameters, y: Outputs, measured: Any, i: int) -> float:
    """Return by how much a wheel misses what was measured, squared [rpm^2]."""
    speed = y.speed[i] - measured[i]
    duty = (y.duty[i] - measured[4 + i]) / max(p.k_p, 1e-9)
    return (0.0 if np.isnan(speed) else speed * speed) + (0.0 if np.isnan(duty) else duty * duty)


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
    """Place the change that stands in row `at`, at one of the ticks `first` to `at`.

    Wheels are placed by themselves, as long as nothing but their own set-points changes.
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

    A table tells that an input changed between two rows, not at which tick. The wheels answer
    within milliseconds, so what they show in the row where the new value stands first tells it.

    Parameters
    ----------
    x0, x, trial
        State before each segment; two to compute with.
    inputs : ndarray, shape (ticks, Inputs.n_words)
        Changed in place: a change stands in its row before, at its own tick afterwards.
    speed_0
        As for `run_drive`.
    is_row : ndarray of bool, shape (ticks,)
        Which ticks the table has a row of.
    measured : ndarray, shape (ticks, 8)
        Speeds [rpm] and duties [%] in the rows, NaN where there is none.
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
        Of the controller; friction and dead zone of a plant that has them come after it.
    x0, x, volts, speed_0
        As for `run_drive`.
    seen : ndarray, shape (ticks, 4)
        Written: speed as the encoder shows it.
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
def _turn_apart(x: State, apart: Any, k: int) -> None:
    """Let the front wheels turn by the difference to the rear ones: `sideways` asks no more."""
    x.speed[0] = apart[0, k]
    x.speed[2] = apart[1, k]


@kernel()
def run_pose(
    p: Parameters,
    x: State,
    which: Any,
    first: Any,
    left: Any,
    right: Any,
    apart: Any,
    pose_0: Any,
    angle_0: Any,
    y: Outputs,
    pose: Any,
) -> None:
    """Run the kinematics alone under given wheel speeds, cut point C.

    Parameters
    ----------
    which : ndarray of int64
        Segments to run; the rows of the others stay as they are.
    left, right : ndarray, shape (ticks,)
        Sum of the speeds of the two wheels of a side [rpm].
    apart : ndarray, shape (2, ticks) or (2, 0)
        Front minus rear wheel of the left and of the right side [rpm]; read of mecanum wheels only.
    pose_0 : ndarray, shape (segments, 3)
    angle_0 : ndarray, shape (segments,)
        Mean angle of the left wheels at the start [rad].
    pose : ndarray, shape (ticks, 4)
        Written: x [m], y [m], yaw [rad] not wrapped, turn rate [rad/s].
    """
    suffice = speeds_suffice(p) and p.slope_x == 0.0 and p.slope_y == 0.0
    for s in which:
        begin, end = first[s], first[s + 1]
        if suffice:
            _run_by_speeds(p, pose_0[s], left[begin:end], right[begin:end], pose[begin:end])
            continue
        for i in range(3):
            x.pose[i] = pose_0[s, i]
        _run_segment(p, x, begin, end - 1, left, right, apart, angle_0[s], y, pose)


@kernel()
def _velocities(p: Parameters, inside: bool, w_l: Any, w_r: Any, out: Any) -> None:
    """Write of every tick the mean velocity ahead, aside, in turn, and the turn rate that shows.

    They do not wait for each other, so the processor computes several at once.
    """
    dt, q = p.dt, of_speeds(p)
    for k in range(w_l.size - 1):
        mean_l, mean_r = 0.5 * (w_l[k] + w_l[k + 1]), 0.5 * (w_r[k] + w_r[k + 1])
        dw_l, dw_r = (w_l[k + 1] - w_l[k]) / dt, (w_r[k + 1] - w_r[k]) / dt
        _, out[3, k], _, _ = velocity_terms(q, inside, 0.0, w_l[k], w_r[k], dw_l, dw_r)
        dw_l, dw_r = (mean_l - w_l[k]) * (2.0 / dt), (mean_r - w_r[k]) * (2.0 / dt)
        v, om, _, _ = velocity_terms(q, inside, 0.0, mean_l, mean_r, dw_l, dw_r)
        out[0, k], out[2, k] = v, om
        out[1, k], _ = across(q, v, om, 0.0, 0.0)


@kernel()
def _run_by_speeds(p: Parameters, pose_0: Any, left: Any, right: Any, pose: Any) -> None:
    """Run one segment by place and wheel speeds alone, to the bit as `_run_segment` does."""
    n, patch = left.size, p.surface_gain != 1.0 or p.surface_speed != 1.0
    w_l, w_r = np.empty(n + 1), np.empty(n + 1)
    w_l[:n], w_r[:n] = left * SIDE, right * SIDE
    w_l[n], w_r[n] = w_l[n - 1], w_r[n - 1]
    both = np.empty((2, 4, n))  # beside the patch and on it
    _velocities(p, False, w_l, w_r, both[0])
    if patch:
        _velocities(p, True, w_l, w_r, both[1])
    px, py, yaw = pose_0[0], pose_0[1], pose_0[2]
    turned = yaw
    for k in range(n):
        i = 1 if patch and in_region(p, px, py) else 0
        pose[k, 0], pose[k, 1], pose[k, 2], pose[k, 3] = px, py, turned, both[i, 3, k]
        dx, dy = shift(yaw, both[i, 0, k], both[i, 1, k], both[i, 2, k], p.dt)
        px, py, before = px + dx, py + dy, yaw
        yaw = turn(yaw, both[i, 2, k], p.dt)
        turned += wrap(yaw - before)


@kernel()
def _run_segment(
    p: Parameters,
    x: State,
    first: int,
    last: int,
    left: Any,
    right: Any,
    apart: Any,
    angle: float,
    y: Outputs,
    pose: Any,
) -> None:
    """Run one segment from the pose of `x` on; see `run_pose`."""
    dt, is_mecanum, aside, turned = p.dt, p.mecanum != 0.0, 0.0, x.pose[2]
    for k in range(first, last + 1):
        following = min(k + 1, last)
        w_l, w_r = left[k] * SIDE, right[k] * SIDE
        next_l, next_r = left[following] * SIDE, right[following] * SIDE
        mean_l, mean_r = 0.5 * (w_l + next_l), 0.5 * (w_r + next_r)
        y.angle[0] = angle
        y.angle[1] = angle
        angle += mean_l * dt
        x.angle[0] = angle
        x.angle[1] = angle
        pose[k, 0] = x.pose[0]
        pose[k, 1] = x.pose[1]
        pose[k, 2] = turned
        before = x.pose[2]
        dw_l, dw_r = (next_l - w_l) / dt, (next_r - w_r) / dt
        if k == first:
            follow_wheels(p, x, y, w_l, w_r, dw_l, dw_r)
        if is_mecanum:
            _turn_apart(x, apart, k)
            aside = sideways(p, x)[0]
            _turn_apart(x, apart, following)
        drive_on_with_terms(p, x, y, w_l, w_r, dw_l, dw_r, mean_l, mean_r, aside, 0.0)
        pose[k, 3] = y.angular
        turned += wrap(x.pose[2] - before)


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


@kernel()
def sample_tag(
    p: Parameters,
    x: State,
    dense: Any,
    low: Any,
    high: Any,
    at_position: Any,
    at_yaw: Any,
    out: Any,
) -> None:
    """Write what the navigation tag shows for a pose, with the plant's own sensor; shape (n, 3).

    Ages are in ``at_position`` and ``at_yaw`` already, so the sensor's own are set to nothing. Yaw
    is not wrapped.
    """
    p.nav_delay = 0.0
    p.nav_yaw_delay = 0.0
    x.nav_head = 0.0
    x.nav_count = 1.0
    for j in range(at_position.size):
        where = min(max(at_position[j], float(low[j])), float(high[j]))
        k = int(where)
        following = min(k + 1, int(high[j]))
        share = where - k
        for c in range(3):
            x.nav_ring[0, c] = dense[k, c] + share * (dense[following, c] - dense[k, c])
        out[j, 0], out[j, 1] = shown_position(p, x)
        where = min(max(at_yaw[j], float(low[j])), float(high[j]))
        k = int(where)
        following = min(k + 1, int(high[j]))
        yaw = dense[k, 2] + (where - k) * (dense[following, 2] - dense[k, 2])
        x.nav_ring[0, 2] = yaw
        out[j, 2] = yaw + wrap(shown_yaw(p, x) - yaw)
