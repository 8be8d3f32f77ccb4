"""Where a map corrects itself the pose jumps: the robot did not, so a segment ends there."""

from dataclasses import replace
from itertools import pairwise
from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.measured.channels import NAV_X, NAV_Y, POSITION, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.measured.own_odometry import wheel_way
from hilserver.measured.pauses import Pieces, cut
from hilserver.measured.thresholds import (
    CORRECTION_LEAST_M,
    CORRECTION_LEAST_RAD,
    CORRECTION_SD,
    CORRECTIONS_APART_S,
    TO_SD,
)

OF_A_MAP: Final = (
    "the pose is that of a map: its error lasts, so many poses say hardly more than a few, and what"
    " the map distorts everywhere alike it does not show"
)
NEAR: Final = 3  # steps on either side that show how the robot moves
AROUND_JUMP: Final = (
    4  # samples on either side of a jump; one that comes back within is a wild one
)


def cut_at_corrections(log: MeasuredLog) -> MeasuredLog:
    """Return a log whose pose was seen by a map, with segments that end where it jumps."""
    edges: list[Pieces] = []
    largest_m, count = 0.0, 0
    for index, span in enumerate(log.spans):
        t_s, columns = _pose(log, index)
        rolled = _rolled(log, index, t_s)
        found: set[int] = set()
        for values, least in columns:
            jumps, size = _jumps(values, least, rolled)
            found |= set(jumps.tolist())
            largest_m = max(largest_m, size if least == CORRECTION_LEAST_M else 0.0)
        at = sorted(found)
        if len(at) * CORRECTIONS_APART_S > span.end_s - span.start_s:
            at = []  # so many are its usual noise
        count += len(at)
        ends_s = [*(float(t_s[i]) for i in at), span.end_s]
        begins_s = [span.start_s, *(float(t_s[i + 1]) for i in at)]
        edges.append(list(zip(begins_s, ends_s, strict=True)))
    if not count:
        return log
    # a heading may jump alone
    by = f", by up to {largest_m:.2g} m" if largest_m > 0.0 else ""
    note = (
        f"the pose jumps {count} times{by}, as where a map corrects itself: the log was cut there,"
        " and each part has a start pose of its own"
    )
    return replace(cut(log, edges), notices=(*log.notices, note))


def _pose(log: MeasuredLog, index: int) -> tuple[Array, list[tuple[Array, float]]]:
    """Return common times of a span's pose, and its parts with their smallest jump."""
    names = [name for name in (*POSITION, YAW) if name in log]
    parts = [log[name].of(index) for name in names]
    if not parts or min(len(t) for t, _ in parts) <= 2 * AROUND_JUMP:
        return np.zeros(0), []
    t_s = parts[0][0]
    for other, _ in parts[1:]:
        t_s = np.intersect1d(t_s, other)
    columns = []
    for name, (own_s, values) in zip(names, parts, strict=True):
        whole = np.unwrap(values) if name == YAW else values
        least = CORRECTION_LEAST_M if name in (NAV_X, NAV_Y) else CORRECTION_LEAST_RAD
        columns.append((whole[np.isin(own_s, t_s)], least))
    return t_s, columns


def _rolled(log: MeasuredLog, index: int, t_s: Array) -> Array:
    """Return how far the wheels went between poses, up to a scale, shape (n - 1,)."""
    way = wheel_way(log, index)
    if way is None or len(t_s) < 2:
        return np.zeros(max(len(t_s) - 1, 0))
    ahead, turned = (np.interp(t_s, way.t_s, sums) for sums in (way.ahead, way.turned))
    return np.abs(np.diff(ahead)) + np.abs(np.diff(turned))


def _jumps(values: Array, least: float, rolled: Array) -> tuple[Indices, float]:
    """Return after which samples a coordinate jumps and stays, and its largest jump.

    Parameters
    ----------
    rolled : array
        How far the wheels went at each step: a coordinate does not jump where they carried it.
    """
    step = np.diff(values)
    if len(step) <= 2 * AROUND_JUMP:
        return np.zeros(0, dtype=np.int64), 0.0
    # Beyond the steps before and after it; a robot that starts or stops stays between them.
    padded = np.pad(step, NEAR, mode="reflect")
    near = np.lib.stride_tricks.sliding_window_view(padded, 2 * NEAR + 1)
    sides = np.stack([np.median(near[:, :NEAR], 1), np.median(near[:, -NEAR:], 1)])
    beyond = step - np.clip(step, sides.min(axis=0), sides.max(axis=0))
    sd = TO_SD * float(np.median(np.abs(step - sides.mean(axis=0))))
    size = np.abs(beyond)
    driven = rolled > 0.1 * rolled.max()
    if driven.any():
        usual = float(np.median(np.abs(step[driven]) / rolled[driven]))
        # a straight or a turn goes further along one coordinate than the usual step
        size = np.maximum(size - 2.0 * usual * rolled, 0.0)
    high = np.flatnonzero(size > max(CORRECTION_SD * sd, least))
    kept = []
    for i in high.tolist():
        around = beyond[max(i - AROUND_JUMP, 0) : i + AROUND_JUMP + 1]
        if abs(float(around.sum())) > 0.5 * size[i]:
            kept.append(i)
    # the largest of neighbours stands for one correction
    single = [
        i for i, after in pairwise([*kept, len(values) * 2]) if after - i > AROUND_JUMP
    ]
    largest = float(size[kept].max()) if kept else 0.0
    return np.array(single, dtype=np.int64), largest
