"""The remaining residual as a function of what it depends on, in bins, for the report."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.decide.structure import Unknown
from hilserver.diagnosis.decide.unknown import peaks
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.pose_stage import FORWARD, HEADING, TURN
from hilserver.diagnosis.replay.stage import Stage
from hilserver.diagnosis.schema.evidence import Dependence
from hilserver.measured.channels import DUTIES, GYRO, POSITION, SETPOINTS, SPEEDS, YAW
from hilserver.measured.names import signal_unit

MOST, EACH = 2, 2  # structures that are drawn, and regressors of each
BASE_S: Final = 1.0  # over which the growth of a pose's error is measured
BINS: Final = 24
FEWEST_IN_A_BIN: Final = 3
ALIKE: Final = 0.98
# a log of at least this many periods is folded over the strongest one
PERIODS: Final = 4.0


@dataclass(frozen=True)
class _Left:
    """The rest of one channel, or of a velocity derived from positions or yaw."""

    name: str
    edge: slice  # samples of the stack at whose times it is given
    values: Array
    used: Mask  # shape of `values`


def dependences(
    problem: Problem, point: Point, unknown: Sequence[Unknown]
) -> list[Dependence]:
    """Return what the remaining error depends on, the strongest structure first.

    Regressors are taken from the final model, so that no sensor's noise is in both.
    """
    out: list[Dependence] = []
    drawn: list[Array] = []
    for u in unknown[:MOST]:
        left = _left(problem, point, u)
        known = _regressors(problem, point, left.edge)
        for name in [r for r in u.family.regressors if r in known][:EACH]:
            label, unit, x = name, signal_unit(name), known[name]
            if name == "t_s":
                label, unit, x = _folded(problem, point, x)
            bins = (
                min(BINS, problem.stack.n_blocks // FEWEST_IN_A_BIN)
                if label == "t_s"
                else BINS
            )
            block = problem.stack.block[left.edge]
            parts = binned(x[left.used], left.values[left.used], block[left.used], bins)
            if any(_alike(x, other) for other in drawn) or len(parts) < 2:
                continue
            drawn.append(x)
            at, mean, half = (np.array(column) for column in zip(*parts, strict=True))
            low, high = mean - half, mean + half
            own = signal_unit(left.name)
            out.append(
                Dependence(
                    left.name,
                    own,
                    label,
                    unit,
                    at,
                    mean,
                    low,
                    high,
                    abs(u.t),
                    u.critical,
                )
            )
    return out


def _alike(x: Array, other: Array) -> bool:
    """Return whether two regressors are the same, like the set-points of both wheels of a side."""
    if len(x) != len(other) or min(np.ptp(x), np.ptp(other)) == 0.0:
        return False
    return bool(abs(np.corrcoef(x, other)[0, 1]) > ALIKE)


def _left(problem: Problem, point: Point, u: Unknown) -> _Left:
    """Return the remaining error of the channel of which a structure explains most.

    The error of a pose accumulates along the way, so its growth is reported.
    """
    edges = problem.stack.edges
    residual, used = problem.residual(point.predicted), problem.weights > 0.0
    norm = np.sqrt((u.family.white**2).sum(axis=0))
    unit = u.family.white[:, norm > 0.0] / norm[norm > 0.0]
    size, *_ = np.linalg.lstsq(unit, point.left, rcond=1e-9)
    explained = point.left**2 - (point.left - unit @ size) ** 2
    share = {n: float(explained[e].sum()) for n, e in edges.items()}
    along = sum(share.get(n, 0.0) for n in POSITION)
    if along > sum(share.get(n, 0.0) for n in (GYRO, YAW)):
        x, y = (edges[n] for n in POSITION)
        yaw = _regressors(problem, point, x)[HEADING]
        forward = [_rate(problem, e, residual[e]) for e in (x, y)]
        ahead = np.cos(yaw) * forward[0] + np.sin(yaw) * forward[1]
        sound = np.isfinite(ahead) & used[x] & used[y]
        return _Left(FORWARD, x, np.nan_to_num(ahead), sound)
    for some in ((GYRO,), DUTIES, SPEEDS):
        if own := [n for n in some if n in edges]:
            name = max(own, key=lambda n: share[n])
            return _Left(name, edges[name], residual[edges[name]], used[edges[name]])
    turned = _rate(problem, edges[YAW], residual[edges[YAW]])
    sound = np.isfinite(turned) & used[edges[YAW]]
    return _Left(TURN, edges[YAW], np.nan_to_num(turned), sound)


def _rate(problem: Problem, edge: slice, values: Array) -> Array:
    """Return how fast a channel's residual grows around each sample; NaN at segment ends."""
    stack, out = problem.stack, np.full(len(values), np.nan)
    t_s, segment = stack.t_s[edge], stack.segment[edge]
    for i in np.unique(segment):
        rows = np.flatnonzero(segment == i)
        known = rows[problem.weights[edge][rows] > 0.0]
        if len(known) < 2:
            continue
        t = t_s[rows]
        inside = (t >= t[0] + 0.5 * BASE_S) & (t <= t[-1] - 0.5 * BASE_S)
        ends = [
            np.interp(t[inside] + half, t_s[known], values[known])
            for half in (-0.5 * BASE_S, 0.5 * BASE_S)
        ]
        out[rows[inside]] = (ends[1] - ends[0]) / BASE_S
    return out


def _regressors(problem: Problem, point: Point, edge: slice) -> Mapping[str, Array]:
    """Return, by name, what is known at the samples of a channel."""
    stage, stack = problem.stage, problem.stack
    row = np.minimum(np.rint(stack.at[edge]).astype(np.int64), stack.high[edge])
    dense = stage.signals(point.model.terms, point.poses)
    out = {"t_s": stack.t_s[edge]} | {
        name: values[row] for name, values in dense.items()
    }
    return out | {
        name: _held(stage, name, edge) for name in SETPOINTS if name in stage.log
    }


def _held(stage: Stage, name: str, edge: slice) -> Array:
    """Return the value of an input, which holds until the next, at the samples of a channel."""
    t_s, segment = stage.stack.t_s[edge], stage.stack.segment[edge]
    out = np.zeros(len(t_s))
    for i, span in enumerate(stage.segments.span):
        t, v = stage.log[name].of(int(span))
        rows = segment == i
        if len(t):
            latest = np.searchsorted(t, t_s[rows] + 1e-9, side="right") - 1
            out[rows] = v[np.maximum(latest, 0)]
    return out


def _folded(problem: Problem, point: Point, t_s: Array) -> tuple[str, str, Array]:
    """Return time, folded over the strongest period of the residual if the log holds many."""
    among = [n for n in (GYRO, *DUTIES) if n in problem.stack.edges]
    found = peaks(
        problem, point, among or [n for n in SPEEDS if n in problem.stack.edges]
    )
    if not found or float(np.ptp(t_s)) * found[0] < PERIODS:
        return "t_s", "s", t_s
    period_s = 1.0 / found[0]
    return f"t_s mod {period_s:.3g}", "s", np.mod(t_s, period_s)


def binned(
    x: Array, residual: Array, block: Indices, bins: int
) -> list[tuple[float, float, float]]:
    """Return middle, mean and half the 95 % interval of every bin that has enough blocks.

    The interval counts blocks, because samples within one are correlated.
    """
    if not len(x) or float(np.ptp(x)) == 0.0:
        return []
    edges = np.linspace(x.min(), x.max(), max(bins, 1) + 1)
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, len(edges) - 2)
    out = []
    for k in range(len(edges) - 1):
        mine = index == k
        _, inside = np.unique(block[mine], return_inverse=True)
        n = int(inside.max(initial=-1)) + 1
        if n < FEWEST_IN_A_BIN:
            continue
        mean = float(residual[mine].mean())
        sums = np.bincount(inside, residual[mine] - mean)
        deviation = float(np.sqrt((sums**2).sum() * n / (n - 1))) / int(mine.sum())
        half = float(stats.t.ppf(0.975, n - 1)) * deviation
        out.append((float(np.median(x[mine])), mean, half))
    return out
