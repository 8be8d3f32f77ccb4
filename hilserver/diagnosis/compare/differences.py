"""Every cause in two sets of logs, estimated together with the causes that both share."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.regression.screen import Scores, score
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.thresholds import COMPARE_INEXACT, FAR_SD
from hilserver.measured.data import MeasuredLog


@dataclass(frozen=True)
class Difference:
    """One cause in both sets."""

    candidate: Candidate
    stage: str
    column: int
    # estimates in A and B, and their standard errors
    values: tuple[float, float]
    errors: tuple[float, float]
    p: float  # of no difference, for all causes together (Bonferroni)
    gain: float  # deviance that two values save compared with one
    dof: float

    @property
    def is_worth_a_name(self) -> bool:
        """Whether the values differ by at least the cause's least size."""
        return abs(self.values[1] - self.values[0]) >= self.candidate.least

    @property
    def is_possible(self) -> bool:
        """Whether a machine can have both values, within their errors and inexactness."""
        c = self.candidate
        if not c.linear:
            return True
        low, high = min(c.low) - min(c.null), max(c.high) - max(c.null)
        share = COMPARE_INEXACT * abs(self.values[1] - self.values[0])
        return all(
            low - share - FAR_SD * error <= value <= high + share + FAR_SD * error
            for value, error in zip(self.values, self.errors, strict=True)
        )


def differences_of(
    stage: str, prepared: Prepared, point: Point, second: Mask, runs: Indices
) -> list[Difference]:
    """Estimate every cause of a stage in both sets, together with the causes that both share.

    Parameters
    ----------
    point : Point
        The model that explains both sets together.
    """
    library, stack = prepared.library, prepared.problem.stack
    span_of_block = np.full(stack.n_blocks, -1)
    span_of_block[stack.block] = prepared.problem.stage.segments.span[stack.segment]
    known = span_of_block >= 0
    later = second[np.maximum(span_of_block, 0)]
    sides = (known & ~later, known & later)
    shared = library.scores(point)
    out = []
    for i, c in enumerate(library.candidates):
        mine = np.flatnonzero(library.owner == i)[: c.n]
        scores, offset = _own_scores(library, point, c, mine) or (shared, np.zeros(c.n))
        rows = mine if scores is shared else np.arange(len(mine))
        for k, j in enumerate(rows):
            if scores.information[j] <= 0.0:
                continue
            d = _one(scores.blocks[:, j], scores.own[:, j], sides, runs, span_of_block)
            if d is None:
                continue
            unit = library.norms[i][k] if c.n > 1 else 1.0
            scale = (1.0 / unit) if c.linear else abs(c.start[0] - c.null[0])
            values, errors, p, gain, dof = d
            both = tuple(v * scale + float(offset[k]) for v in values)
            spread = (errors[0] * scale, errors[1] * scale)
            place = int(mine[k])
            out.append(
                Difference(c, stage, place, (both[0], both[1]), spread, p, gain, dof)
            )
    return out


def _own_scores(
    library: Library, point: Point, c: Candidate, mine: Indices
) -> tuple[Scores, Array] | None:
    """Return scores and values of a shared cause, given the others; None for other causes."""
    index = next(
        (k for k, f in enumerate(point.model.fitted) if f.candidate.label == c.label),
        -1,
    )
    if index < 0:
        return None
    accepted = library.problem.accepted(point)
    assert accepted is not None
    others = np.delete(accepted, point.model.slices[index], axis=1)
    order = library.blocks.order
    scores = score(
        library.columns[:, mine], point.left[order], library.blocks, others[order]
    )
    return scores, np.asarray(point.model.fitted[index].theta) - np.asarray(c.null)


def _one(
    score: Array,
    information: Array,
    sides: Sequence[Mask],
    runs: Indices,
    span_of_block: Indices,
) -> tuple[tuple[float, float], tuple[float, float], float, float, float] | None:
    """Return estimates, errors, p, gain and degrees of freedom of one direction."""
    values, variances, counts, infos, repeats = [], [], [], [], []
    for side in sides:
        g, i = score[side], information[side]
        used = i > 1e-9
        if used.sum() < 3:
            return None
        total = float(i.sum())
        value = float(g.sum()) / total
        n = int(used.sum())
        variance = float(((g - value * i) ** 2).sum()) / total**2 * n / (n - 1)
        count = n - 1
        run = runs[np.maximum(span_of_block[side], 0)]
        names = np.unique(run[used])
        if len(names) >= 2:
            per = [
                float(g[run == r].sum()) / max(float(i[run == r].sum()), 1e-12)
                for r in names
            ]
            between = float(np.var(per, ddof=1)) / len(names)
            if between > variance:
                variance, count, value = between, len(names) - 1, float(np.mean(per))
        repeats.append(len(names) if count == len(names) - 1 else 0)
        values.append(value)
        variances.append(max(variance, 1.0 / total))
        counts.append(count)
        infos.append(total)
    both = variances[0] + variances[1]
    dof = both**2 / sum(v**2 / c for v, c in zip(variances, counts, strict=True))
    if (
        repeats[0] == repeats[1] > 1
    ):  # with equally many runs, Student's test is valid, too
        dof = float(sum(counts))
    t = (values[1] - values[0]) / np.sqrt(both)
    p = float(2.0 * stats.t.sf(abs(t), dof))
    gain = (values[1] - values[0]) ** 2 / (1.0 / infos[0] + 1.0 / infos[1])
    errors = (float(np.sqrt(variances[0])), float(np.sqrt(variances[1])))
    return (values[0], values[1]), errors, p, float(gain), float(dof)


def run_of_spans(logs: Sequence[MeasuredLog]) -> Indices:
    """Return the run that every span of the pooled log belongs to: its file.

    In a set of one file with several segments, every block of its own counts as a run, or every
    segment if it has no blocks.
    """
    runs: list[int] = []
    for log in logs:
        begin = max(runs, default=-1) + 1
        blocks = [s.block for s in log.spans]
        if len(log.sources) in (0, 1) and None not in blocks and len(set(blocks)) > 1:
            number = {block: i for i, block in enumerate(dict.fromkeys(blocks))}
            runs += [begin + number[block] for block in blocks]
        elif len(log.sources) in (0, 1) or len(log.sources) != len(log.spans):
            runs += [begin + i for i in range(len(log.spans))]
        else:
            runs += [begin + i for i in range(len(log.sources))]
    return np.array(runs, dtype=np.int64)
