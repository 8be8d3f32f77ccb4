"""Do two sets of logs differ, and in what? The unit is the run where there are several.

Every cause is estimated in both sets, at the model that both share. The difference is judged
against the scatter between blocks and, with two runs or more on each side, between runs: one run's
own precision says nothing about the next run.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from hilserver import __version__
from hilserver.assembly import Assembly
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.columns import Library
from hilserver.diagnosis.data import Channel, MeasuredLog
from hilserver.diagnosis.engine import Tell, silent
from hilserver.diagnosis.evidence import Diagnosis, Evidence
from hilserver.diagnosis.explain import separating_experiment
from hilserver.diagnosis.findings import (
    Detectable,
    Finding,
    Findings,
    LogFile,
    NotJudged,
    Overall,
    Parameter,
    Verdict,
)
from hilserver.diagnosis.identifiability import GROUP_COSINE
from hilserver.diagnosis.library import Candidate
from hilserver.diagnosis.outcome import unit_of
from hilserver.diagnosis.problem import Point
from hilserver.diagnosis.screen import Scores, score
from hilserver.diagnosis.selection import TIE, select
from hilserver.diagnosis.stages import (
    Prepared,
    machine,
    on_a_frame,
    prepare_all,
    standing,
    vocabulary_reasons,
    without_motion,
)
from hilserver.diagnosis.vocabulary import CAUSES

Array = NDArray[np.float64]

LEVEL = 0.01


@dataclass(frozen=True)
class Difference:
    """One cause in both sets.

    Attributes
    ----------
    values, errors : tuple of float
        Estimates in A and B, and their standard errors.
    p : float
        Of no difference, for all causes together (Bonferroni).
    gain : float
        Deviance that two values save against one.
    """

    candidate: Candidate
    stage: str
    column: int
    values: tuple[float, float]
    errors: tuple[float, float]
    p: float
    gain: float
    dof: float

    @property
    def is_worth_a_name(self) -> bool:
        """Whether the values lie as far apart as the cause's least size."""
        return abs(self.values[1] - self.values[0]) >= self.candidate.least


def together(a: MeasuredLog, b: MeasuredLog) -> tuple[MeasuredLog, NDArray[np.bool_]]:
    """Return both sets as one log, and which of its spans belong to the second."""
    shift = len(a.spans)
    channels = {}
    for name in a.channels.keys() & b.channels.keys():
        x, y = a[name], b[name]
        channels[name] = Channel(
            np.concatenate([x.t_s, y.t_s]),
            np.concatenate([x.values, y.values]),
            np.concatenate([x.span, y.span + shift]),
        )
    spans = (*a.spans, *(replace(s, number=s.number + shift, block=None) for s in b.spans))
    spans = tuple(replace(s, block=None) for s in spans)
    second = np.arange(len(spans)) >= shift
    log = replace(a, sources=(*a.sources, *b.sources), channels=channels, spans=spans)
    return log, second


def compare(
    log: MeasuredLog,
    other: MeasuredLog,
    assembly: Assembly,
    *,
    seed: int = 0,
    jobs: int = 2,
    progress: Tell | None = None,
) -> Diagnosis:
    """Judge whether `other` differs from `log`, and in what.

    Returns
    -------
    Diagnosis
        Verdict ``differs`` or ``no_difference``; parameters ``<cause>.a`` and ``<cause>.b`` are the
        values of both sets, ``<cause>`` their difference.
    """
    tell = progress or silent
    robot = machine(log, assembly.robot)
    both = [check(one, robot) for one in (log, other)]
    faults = [finding for checked in both for finding in checked.findings]
    cleaned = [checked.log for checked in both]
    if any(standing(one, robot) or without_motion(one, robot) for one in cleaned):
        cleaned = [on_a_frame(one) for one in cleaned]
    pooled, second = together(*cleaned)
    prepared, reasons = prepare_all(
        pooled, robot, jobs, tell, lost_setpoints=any(checked.lost_setpoints for checked in both)
    )
    runs = run_of_spans(cleaned)
    differences: list[Difference] = []
    shared = select(
        {n: p.problem for n, p in prepared.items()},
        {n: p.library for n, p in prepared.items()},
        {n: p.base for n, p in prepared.items()},
        np.random.default_rng(seed),
    )
    for name, p in prepared.items():
        differences += differences_of(name, p, shared[name].point, second, runs)
    count = max(len({d.candidate.label for d in differences}), 1)
    differences = [replace(d, p=min(d.p * count, 1.0)) for d in differences]
    found = _findings(differences, prepared)
    detectable = _detectable(differences, count)
    findings = Findings(
        verdict=Overall.DIFFERS if found else Overall.NO_DIFFERENCE,
        logs=tuple(LogFile(file=s.file, sha256=s.sha256) for s in pooled.sources),
        seed=seed,
        version=__version__,
        config_sha256=assembly.config.sha256,
        findings=(*faults, *found),
        smallest_detectable=detectable,
        not_judged=tuple(
            NotJudged(cause=c, reason=r)
            for c, r in vocabulary_reasons(
                {d.candidate.cause for d in differences}, reasons, set(prepared)
            ).items()
        ),
        notices=tuple(note for one in cleaned for note in one.notices),
    )
    return Diagnosis(findings, Evidence())


def run_of_spans(logs: Sequence[MeasuredLog]) -> NDArray[np.int64]:
    """Return the run that every span of the pooled log belongs to: its file.

    A set of one file with several segments counts every block of its own as a run, every segment
    where it has none.
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


def differences_of(
    stage: str,
    prepared: Prepared,
    point: Point,
    second: NDArray[np.bool_],
    runs: NDArray[np.int64],
) -> list[Difference]:
    """Estimate every cause of a stage in both sets, beside the causes that both share.

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
            out.append(Difference(c, stage, place, (both[0], both[1]), spread, p, gain, dof))
    return out


def _own_scores(
    library: Library, point: Point, c: Candidate, mine: NDArray[np.int64]
) -> tuple[Scores, Array] | None:
    """Return scores and values of a shared cause, beside the others; None for other causes."""
    index = next((k for k, f in enumerate(point.model.fitted) if f.candidate.label == c.label), -1)
    if index < 0:
        return None
    begin = sum(f.candidate.n for f in point.model.fitted[:index])
    accepted = library.problem.accepted(point)
    assert accepted is not None
    others = np.delete(accepted, np.s_[begin : begin + c.n], axis=1)
    order = library.blocks.order
    scores = score(library.columns[:, mine], point.left[order], library.blocks, others[order])
    return scores, np.asarray(point.model.fitted[index].theta) - np.asarray(c.null)


def _one(
    score: Array,
    information: Array,
    sides: Sequence[NDArray[np.bool_]],
    runs: NDArray[np.int64],
    span_of_block: NDArray[np.int64],
) -> tuple[tuple[float, float], tuple[float, float], float, float, float] | None:
    """Return estimates, errors, p, gain and degrees of freedom of one direction."""
    values, variances, counts, infos = [], [], [], []
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
            per = [float(g[run == r].sum()) / max(float(i[run == r].sum()), 1e-12) for r in names]
            between = float(np.var(per, ddof=1)) / len(names)
            if between > variance:
                variance, count, value = between, len(names) - 1, float(np.mean(per))
        values.append(value)
        variances.append(max(variance, 1.0 / total))
        counts.append(count)
        infos.append(total)
    both = variances[0] + variances[1]
    dof = both**2 / sum(v**2 / c for v, c in zip(variances, counts, strict=True))
    t = (values[1] - values[0]) / np.sqrt(both)
    p = float(2.0 * stats.t.sf(abs(t), dof))
    gain = (values[1] - values[0]) ** 2 / (1.0 / infos[0] + 1.0 / infos[1])
    errors = (float(np.sqrt(variances[0])), float(np.sqrt(variances[1])))
    return (values[0], values[1]), errors, p, float(gain), float(dof)


def _findings(differences: Sequence[Difference], prepared: dict[str, Prepared]) -> list[Finding]:
    """Name the cause that explains the difference best in each stage, with its twins."""
    found = []
    for stage, p in prepared.items():
        mine = sorted(
            (d for d in differences if d.stage == stage and d.p < LEVEL and d.is_worth_a_name),
            key=lambda d: -d.gain,
        )
        if not mine:
            continue
        best = mine[0]
        if best.gain < 10.0:
            continue
        group = [best]
        for d in mine[1:]:
            if d.candidate.cause in {g.candidate.cause for g in group}:
                continue
            if best.gain - d.gain < TIE and _cosine(p.library, best, d) > GROUP_COSINE:
                group.append(d)
        found.append(_finding(group))
    return found


def _cosine(library: Library, a: Difference, b: Difference) -> float:
    x, y = (library.columns[:, d.column].astype(np.float64) for d in (a, b))
    return abs(float(x @ y)) / float(np.linalg.norm(x) * np.linalg.norm(y) + 1e-300)


def _finding(group: Sequence[Difference]) -> Finding:
    parameters: dict[str, Parameter] = {}
    words = []
    for d in group:
        name = next(iter(d.candidate.terms(d.candidate.start)))
        name = "clock_offset.nav" if name == "shift.nav" else name
        unit, wide = unit_of(name), float(stats.t.ppf(0.975, max(d.dof, 1.0)))
        for key, value, error in zip("ab", d.values, d.errors, strict=True):
            limits = (value - wide * error, value + wide * error)
            parameters[f"{name}.{key}"] = Parameter(value=value, ci95=limits, unit=unit)
        change = d.values[1] - d.values[0]
        half = wide * float(np.hypot(*d.errors))
        parameters[name] = Parameter(value=change, ci95=(change - half, change + half), unit=unit)
        text = "" if unit == "1" else f" {unit}"
        words.append(f"{name}: {d.values[0]:.3g}{text} before, {d.values[1]:.3g}{text} after")
    causes = tuple(d.candidate.cause for d in group)
    return Finding(
        verdict=Verdict.DIFFERS,
        causes=causes,
        block=CAUSES[causes[0]].block,
        parameters=parameters,
        p_adjusted=group[0].p,
        explanation=f"The two sets differ: {'; or '.join(words)}.",
        separating_experiment=separating_experiment(causes) if len(causes) > 1 else None,
    )


def _detectable(differences: Sequence[Difference], count: int) -> tuple[Detectable, ...]:
    sizes: dict[str, Detectable] = {}
    for d in differences:
        aim = float(stats.t.ppf(1.0 - 0.5 * LEVEL / count, max(d.dof, 1.0))) + 0.95
        size = max(aim * float(np.hypot(*d.errors)), d.candidate.least)
        cause = d.candidate.cause
        if cause not in sizes or size < sizes[cause].size:
            name = next(iter(d.candidate.terms(d.candidate.start)))
            sizes[cause] = Detectable(cause=cause, size=size, unit=unit_of(name))
    return tuple(sizes.values())
