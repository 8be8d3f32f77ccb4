"""What the extension gains on data left out of its fit: one step and free runs.

A free run starts at the measured pose of a window and is compared at its end; windows begin every
`horizon / 2`. Blocks alternate between training and test, in both directions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.findings import Gain
from hilserver.diagnosis.thresholds import CLEARLY_SE, FEWEST_BLOCKS, STRETCHES
from hilserver.measured.channels import POSITION, TAG, YAW

RESAMPLES = 400
# longer than any segment, so that the stamps of two segments differ
SEGMENTS_APART_S = 1e7
HORIZON_S = 5.0  # length of the free runs for which the gain is reported
HORIZONS_S = (1.0, 2.0, 5.0, 10.0, 20.0)


@dataclass(frozen=True)
class Errors:
    """Absolute errors of one quantity and the block of each."""

    values: Array
    block: Indices


def crossed(problem: Problem, point: Point, model: Model) -> list[Array]:
    """Return predictions of both folds with parameters fitted on the other fold.

    Element f holds the prediction of all samples by the fit without fold f.
    """
    predictions = []
    for test in (0, 1):
        train = problem.stack.fold != test
        if not model.fitted or not train.any():
            at = fit(problem, model, point, iterations=0)
        else:
            at = fit(problem, model, point, rows=train, iterations=3)
        predictions.append(at.predicted)
    return predictions


def held_out(problem: Problem, predictions: Sequence[Array]) -> Array:
    """Return every sample's prediction by the fit that did not see its block."""
    fold = problem.stack.fold[problem.stack.block]
    return np.where(fold == 0, predictions[0], predictions[1])


def of_halves(problem: Problem, predictions: Sequence[Array]) -> Array:
    """Return every sample's prediction by the selection and fit that did not see its half."""
    half = problem.stack.half[problem.stack.block]
    return np.where(half == 0, predictions[0], predictions[1])


def channel_errors(
    problem: Problem, predicted: Array, names: Sequence[str]
) -> Errors | None:
    """Return absolute residuals of some channels."""
    stack = problem.stack
    residual = np.abs(problem.residual(predicted))
    rows = [
        np.arange(stack.edges[n].start, stack.edges[n].stop)
        for n in names
        if n in stack.edges
    ]
    if not rows:
        return None
    rows_ = np.concatenate(rows)
    return Errors(residual[rows_], stack.block[rows_])


@dataclass(frozen=True)
class Windows:
    """Free runs: where they begin and end, as indices into the samples of each channel."""

    # shape (n,)
    start: Mapping[str, Indices]
    end: Mapping[str, Indices]
    horizon_s: float  # mean length


def windows(problem: Problem, horizon_s: float) -> Windows | None:
    """Return free runs of one length inside segments, or whole segments if these are shorter.

    With an infinite horizon these are all segments, whole; otherwise each run stays inside one half
    of the blocks, and touches nothing that its prediction was fitted to.
    """
    stack = problem.stack
    names = [n for n in TAG if n in stack.edges]
    if not names:
        return None
    edge = stack.edges[names[0]]
    t, segment = stack.t_s[edge], stack.segment[edge]
    whole = np.isinf(horizon_s)
    bounds = np.flatnonzero(np.diff(segment if whole else stack.pieces[edge])) + 1
    stretches = [
        (int(segment[a]), t[a:b])
        for a, b in zip([0, *bounds.tolist()], [*bounds.tolist(), len(t)], strict=True)
        if b - a >= 3
    ]
    longest_s = max((float(np.ptp(own)) for _, own in stretches), default=0.0)
    horizon_s = min(horizon_s, longest_s)
    runs: list[tuple[int, float, float]] = []
    for number, own in stretches:
        length = float(np.ptp(own))
        if whole or length < 1.5 * horizon_s:
            if whole or length > 0.6 * horizon_s:
                runs.append((number, own[0], own[-1]))
            continue
        begins = np.arange(own[0], own[-1] - horizon_s, 0.5 * horizon_s)
        runs += [(number, begin, begin + horizon_s) for begin in begins]
    if len(runs) < FEWEST_BLOCKS:
        return None
    segments, begin, end = (np.array(column) for column in zip(*runs, strict=True))
    starts = {n: _nearest(problem, n, segments, begin) for n in names}
    ends = {n: _nearest(problem, n, segments, end) for n in names}
    length_s = t[ends[names[0]]] - t[starts[names[0]]]
    return Windows(starts, ends, float(np.mean(length_s)))


def _nearest(problem: Problem, name: str, segment: Indices, t_s: Array) -> Indices:
    """Return the samples of a channel nearest to given times of given segments."""
    edge, start_s = problem.stack.edges[name], problem.stage.segments.start_s
    mine = problem.stack.segment[edge]
    own = mine * SEGMENTS_APART_S + problem.stack.t_s[edge] - start_s[mine]
    wanted = segment * SEGMENTS_APART_S + t_s - start_s[segment]
    above = np.clip(np.searchsorted(own, wanted), 1, len(own) - 1)
    below = above - 1
    return np.asarray(np.where(wanted - own[below] < own[above] - wanted, below, above))


def missed(problem: Problem, predicted: Array, w: Windows) -> dict[str, NDArray[Any]]:
    """Return the errors at the end of free runs that start at the measured pose.

    By quantity, shape (runs,): yaw, wrapped; position as x + iy.
    """
    stack, out = problem.stack, {}
    values = stack.values
    turn: Array | float = 0.0
    if YAW in stack.edges:
        off = values[stack.edges[YAW]] - predicted[stack.edges[YAW]]
        d = off[w.end[YAW]] - off[w.start[YAW]]
        out["yaw_rad"] = d - 2.0 * np.pi * np.rint(d / (2.0 * np.pi))
        turn = off[w.start[YAW]]
    if all(n in stack.edges for n in POSITION):
        x, y = (stack.edges[n] for n in POSITION)
        start, end = w.start[POSITION[0]], w.end[POSITION[0]]
        z, s = values[x] + 1j * values[y], predicted[x] + 1j * predicted[y]
        move = (s[end] - s[start]) * np.exp(1j * np.asarray(turn))
        out["position_m"] = z[end] - z[start] - move
    return out


def free_run_errors(
    problem: Problem, predicted: Array, w: Windows
) -> dict[str, Errors]:
    """Return errors at the end of free runs that start at the measured pose."""
    out = {}
    for key, off in missed(problem, predicted, w).items():
        name = YAW if key == "yaw_rad" else POSITION[0]
        block = problem.stack.block[problem.stack.edges[name]]
        out[key] = Errors(np.abs(off), block[w.end[name]])
    return out


def compare(
    before: Errors, after: Errors, horizon_s: float, rng: np.random.Generator
) -> Gain:
    """Return mean errors, their ratio and its bootstrap interval over stretches of blocks.

    Neighbours are drawn together as far as their errors are alike (Kuensch 1989): free runs
    overlap, and what is behind an error lasts. Block by block the interval would be too narrow.
    """
    n = int(before.block.max()) + 1
    sums = np.stack(
        [np.bincount(e.block, weights=e.values, minlength=n) for e in (before, after)]
    )
    sums = sums[:, np.bincount(before.block, minlength=n) > 0]
    count = sums.shape[1]
    b, a = float(before.values.mean()), float(after.values.mean())
    ci = None
    if count >= 4:
        long = alike(sums[0] - b / max(a, 1e-300) * sums[1])
        starts = rng.integers(0, count, size=(RESAMPLES, -(-count // long)))
        picks = (starts[:, :, None] + np.arange(long)) % count
        drawn = sums[:, picks.reshape(RESAMPLES, -1)[:, :count]].sum(axis=2)
        ratios = drawn[0] / np.maximum(drawn[1], 1e-300)
        ci = (float(np.quantile(ratios, 0.025)), float(np.quantile(ratios, 0.975)))
    return Gain(
        horizon_s=horizon_s, before=b, after=a, ratio=b / max(a, 1e-300), ci95=ci
    )


def alike(unlike: Array) -> int:
    """Return over how many blocks in a row their values are alike, shape (blocks,); 1: not at all.

    It is at most an eighth of them: fewer stretches would not show their scatter.
    """
    away = unlike - unlike.mean()
    clear = CLEARLY_SE * float(away @ away) / np.sqrt(len(away))
    most = max(len(away) // STRETCHES, 1)
    for lag in range(1, most + 1):
        if float(away[lag:] @ away[:-lag]) <= clear:
            return min(2 * lag - 1, most)
    return most


def gains(
    problem: Problem,
    before: Array,
    after: Array,
    horizon_s: float,
    rng: np.random.Generator,
) -> dict[str, Gain]:
    """Return the gain of every quantity of a stage at one horizon."""
    return pooled_gains([errors(problem, (before, after), horizon_s)], rng)


@dataclass(frozen=True)
class Pair:
    """Errors of one quantity before and after, over free runs of one mean length."""

    before: Errors
    after: Errors
    horizon_s: float


def errors(
    problem: Problem, predictions: tuple[Array, Array], horizon_s: float
) -> dict[str, Pair]:
    """Return the errors of every quantity of a stage, before and after."""
    out: dict[str, Pair] = {}
    w = windows(problem, horizon_s)
    if w is not None:
        first, second = (free_run_errors(problem, p, w) for p in predictions)
        for key in first:
            out[key] = Pair(first[key], second[key], w.horizon_s)
    for key, some in problem.stage.quantities.items():
        e = [channel_errors(problem, p, some) for p in predictions]
        if e[0] is not None and e[1] is not None:
            out[key] = Pair(e[0], e[1], 0.0 if np.isinf(horizon_s) else horizon_s)
    return out


def pooled_gains(
    parts: Sequence[Mapping[str, Pair]], rng: np.random.Generator
) -> dict[str, Gain]:
    """Return the gain of every quantity over one or several problems together."""
    out = {}
    for key in dict.fromkeys(key for part in parts for key in part):
        pairs = [part[key] for part in parts if key in part]
        counts = [len(pair.before.values) for pair in pairs]
        horizon_s = float(
            np.average([pair.horizon_s for pair in pairs], weights=counts)
        )
        before = _together([pair.before for pair in pairs])
        after = _together([pair.after for pair in pairs])
        out[key] = compare(before, after, horizon_s, rng)
    return out


def _together(parts: Sequence[Errors]) -> Errors:
    """Return errors of several problems together; each keeps its own blocks."""
    sizes = [int(part.block.max(initial=-1)) + 1 for part in parts]
    begins = np.cumsum([0, *sizes[:-1]])
    return Errors(
        np.concatenate([part.values for part in parts]),
        np.concatenate(
            [part.block + begin for part, begin in zip(parts, begins, strict=True)]
        ),
    )
