"""Compiled free runs of the plant's kinematics over whole logs, cut point C, and of its tag.

Segments lie one after the other in all arrays, see `kernels`.
"""

import math
from typing import Any, Final

import numpy as np

from hilserver.compiled import kernel
from hilserver.plant.kinematics import (
    across,
    in_region,
    of_speeds,
    sideways,
    speeds_suffice,
    velocity_terms,
)
from hilserver.plant.layout import Outputs, Parameters, State
from hilserver.plant.nav import shown_position, shown_yaw
from hilserver.plant.pose import sinc, wrap
from hilserver.plant.robot import SIDE, drive_on_with_terms, follow_wheels

EXACT_EVERY: Final = 64
"""Ticks after which a direction is recomputed from its heading, so that rounding cannot add up."""


@kernel()
def _turn_apart(x: State, apart: Any, k: int) -> None:
    """Let the front wheels turn by the difference to the rear ones: `sideways` needs no more."""
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
        Segments to run; the rows of the others are left unchanged.
    left, right : ndarray, shape (ticks,)
        Sum of the speeds of the two wheels of a side [rpm].
    apart : ndarray, shape (2, ticks) or (2, 0)
        Front minus rear wheel of the left and the right side [rpm]; used for mecanum wheels only.
    pose_0 : ndarray, shape (segments, 3)
    angle_0 : ndarray, shape (segments,)
        Mean angle of the left wheels at the start [rad].
    pose : ndarray, shape (ticks, 4)
        Output: x [m], y [m], yaw [rad] not wrapped, turn rate [rad/s].
    """
    suffice = speeds_suffice(p) and p.slope_x == 0.0 and p.slope_y == 0.0
    for s in which:
        begin, end = first[s], first[s + 1]
        if suffice:
            _run_by_speeds(
                p, pose_0[s], left[begin:end], right[begin:end], pose[begin:end]
            )
            continue
        for i in range(3):
            x.pose[i] = pose_0[s, i]
        _run_segment(p, x, begin, end - 1, left, right, apart, angle_0[s], y, pose)


@kernel()
def _velocities(p: Parameters, inside: bool, w_l: Any, w_r: Any, out: Any) -> None:
    """Write the mean velocities of every tick (forward, lateral, turn), and the shown turn rate.

    They do not depend on each other, so the processor computes several at once.
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
def _run_by_speeds(
    p: Parameters, pose_0: Any, left: Any, right: Any, pose: Any
) -> None:
    """Run one segment from place and wheel speeds alone, as `_run_segment` does.

    Headings are the same to the bit. Directions are rotated along with them, since a sine and a
    cosine per tick would be most of the work; so positions differ by rounding.
    """
    n, patch = left.size, p.surface_gain != 1.0 or p.surface_speed != 1.0
    w_l, w_r = np.empty(n + 1), np.empty(n + 1)
    w_l[:n], w_r[:n] = left * SIDE, right * SIDE
    w_l[n], w_r[n] = w_l[n - 1], w_r[n - 1]
    both = np.empty((2, 4, n))  # off the patch and on it
    _velocities(p, False, w_l, w_r, both[0])
    if patch:
        _velocities(p, True, w_l, w_r, both[1])
    px, py, yaw, dt = pose_0[0], pose_0[1], pose_0[2], p.dt
    turned, cos, sin = yaw, 1.0, 0.0
    for k in range(n):
        if k % EXACT_EVERY == 0:
            cos, sin = math.cos(yaw), math.sin(yaw)
        i = 1 if patch and in_region(p, px, py) else 0
        pose[k, 0], pose[k, 1], pose[k, 2], pose[k, 3] = px, py, turned, both[i, 3, k]
        half = 0.5 * both[i, 2, k] * dt
        chord = sinc(half)
        s = chord * half
        c = math.sqrt(1.0 - s * s)  # no robot turns half a turn in a tick
        chord_x, chord_y = cos * c - sin * s, sin * c + cos * s  # the chord's direction
        v, vy = dt * chord * both[i, 0, k], dt * chord * both[i, 1, k]
        px, py = px + (v * chord_x - vy * chord_y), py + (v * chord_y + vy * chord_x)
        more, less = 1.0 - 2.0 * s * s, 2.0 * s * c
        cos, sin = cos * more - sin * less, sin * more + cos * less
        before = yaw
        yaw = wrap(yaw + half + half)
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
    """Run one segment starting from the pose of `x`; see `run_pose`."""
    dt, is_mecanum, lateral, turned = p.dt, p.mecanum != 0.0, 0.0, x.pose[2]
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
            lateral = sideways(p, x)[0]
            _turn_apart(x, apart, following)
        drive_on_with_terms(p, x, y, w_l, w_r, dw_l, dw_r, mean_l, mean_r, lateral, 0.0)
        pose[k, 3] = y.angular
        turned += wrap(x.pose[2] - before)


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

    Ages are already in ``at_position`` and ``at_yaw``, so the sensor's own are set to zero. Yaw
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
