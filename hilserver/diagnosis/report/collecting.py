"""Collects the evidence: what the report draws."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.config.patch import FittedIn
from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG, unit_of
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.findings.worth import MemberStage
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.gain import (
    HORIZONS_S,
    compare,
    free_run_errors,
    windows,
)
from hilserver.diagnosis.regression.screen import adjusted, critical, null_maxima
from hilserver.diagnosis.replay.pose_stage import FORWARD, TURN
from hilserver.diagnosis.report import cuts
from hilserver.diagnosis.report.course import courses
from hilserver.diagnosis.report.dependence import dependences
from hilserver.diagnosis.schema.decisions import ScreenRow
from hilserver.diagnosis.schema.evidence import (
    ChannelSeries,
    Evidence,
    FittedTerm,
    HorizonRow,
    Path,
    Similarity,
)
from hilserver.measured.channels import POSITION, SPEEDS, VOLTAGE, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.measured.names import signal_unit

MOST_PATHS = 4
"""Paths that are drawn: chosen evenly from those that cover about as much ground as the largest."""
HALF_AS_LARGE = 0.5


def evidence(
    log: MeasuredLog,
    stages: Sequence[MemberStage],
    terms: tuple[FittedTerm, ...],
    timings_s: Mapping[str, float],
) -> Evidence:
    """Collect the evidence behind the findings of one member."""
    extended = bool(terms) and any((p.after != p.before).any() for p in stages)
    prepared = [part.judged.prepared for part in stages]
    start_s = min(
        (float(c.t_s[0]) for c in log.channels.values() if len(c.t_s)), default=0.0
    )
    return Evidence(
        series=tuple(
            replace(item, t_s=item.t_s - start_s)
            for p in stages
            for item in _series(p, extended)
        ),
        paths=tuple(path for p in stages for path in _paths(p, extended)),
        cuts=cuts.cuts(prepared),
        screen=tuple(row for p in stages for row in _screen(p.judged)),
        similarity=_similarity(stages[-1].judged.prepared.library) if stages else None,
        gain_by_horizon=tuple(row for p in stages for row in _horizons(p)),
        dependences=tuple(
            replace(item, x=item.x - start_s) if item.regressor == "t_s" else item
            for p in stages
            for item in dependences(p.problem, p.judged.point, p.judged.unknown)
        ),
        courses=tuple(
            replace(item, t_s=item.t_s - start_s)
            for p in stages
            for item in courses(p.problem, p.judged.point, set(p.judged.drift))
        ),
        extension=terms,
        fitted=_range(log, stages),
        timings_s=dict(timings_s),
        remarks=cuts.remarks(prepared),
    )


def _series(part: MemberStage, extended: bool) -> list[ChannelSeries]:
    problem, stack = part.problem, part.problem.stack
    span = problem.stage.segments.span[stack.segment]
    first, second = problem.residual(part.before), problem.residual(part.after)
    out = []
    for name in stack.channels:
        e = stack.edges[name]
        measured = stack.values[e]
        if name == YAW:
            measured = _unwrapped(measured, span[e])
        out.append(
            ChannelSeries(
                name,
                signal_unit(name),
                stack.t_s[e],
                measured,
                measured - first[e],
                measured - second[e] if extended else None,
                stack.segment[e],
            )
        )
    return out


def _unwrapped(values: Array, span: Indices) -> Array:
    out = values.copy()
    for s in np.unique(span):
        out[span == s] = np.unwrap(values[span == s])
    return out


def _screen(judged: JudgedStage) -> list[ScreenRow]:
    library, scores = judged.prepared.library, judged.scores
    maxima = null_maxima([scores], np.random.default_rng(0))
    limit = critical(maxima)
    if limit <= 0.0:  # no cause at all is visible in such data
        return []
    rows: dict[str, ScreenRow] = {}
    for i, c in enumerate(library.candidates):
        mine = np.flatnonzero(library.owner == i)
        j = int(mine[np.argmax(np.abs(scores.t[mine]))])
        part = next(iter(c.terms(c.start)))
        part = OF_THE_LOG.get(part, part)
        t = float(scores.t[j])
        if c.cause in rows and abs(rows[c.cause].statistic) >= abs(t):
            continue
        share = float(scores.size[j])
        value = c.null[0] + share * (1.0 if c.linear else c.start[0] - c.null[0])
        size = share * (1.0 if c.linear else abs(c.start[0] - c.null[0]))
        is_possible = not c.is_limit and c.low[0] <= value <= c.high[0]
        rows[c.cause] = ScreenRow(
            cause=c.cause,
            part="" if part == c.cause else part.partition(".")[2],
            statistic=t,
            critical=limit,
            p_adjusted=float(adjusted(np.array([t]), maxima)[0]),
            size=size if is_possible else None,
            standard_error=abs(size / t) if t else 0.0,
            unit=unit_of(part),
            dof=float(library.problem.stack.n_blocks),
        )
    return list(rows.values())


def _horizons(part: MemberStage) -> list[HorizonRow]:
    problem, rng, out = part.problem, np.random.default_rng(0), []
    seen: set[float] = set()
    for horizon_s in HORIZONS_S:
        w = windows(problem, horizon_s)
        if w is None or round(w.horizon_s, 1) in seen:
            continue
        seen.add(round(w.horizon_s, 1))
        first, second = (
            free_run_errors(problem, p, w) for p in (part.before, part.after)
        )
        for key in first:
            gain = compare(first[key], second[key], w.horizon_s, rng)
            out.append(HorizonRow(key, gain))
    return out


def _paths(part: MemberStage, extended: bool) -> tuple[Path, ...]:
    stack = part.problem.stack
    if not all(n in stack.edges for n in POSITION):
        return ()
    x, y = (stack.edges[n] for n in POSITION)
    if x.stop - x.start != y.stop - y.start:
        return ()
    segment = stack.segment[x]
    span = part.problem.stage.segments.span[segment]
    out = []
    for k in np.unique(span):
        rows = span == k
        tracks = [
            np.stack([v[x][rows], v[y][rows]], axis=1)
            for v in (stack.values, part.before, part.after)
        ]
        begins = tuple((np.flatnonzero(np.diff(segment[rows])) + 1).tolist())
        out.append(
            Path(int(k), tracks[0], tracks[1], tracks[2] if extended else None, begins)
        )
    least_m = HALF_AS_LARGE * max(way.size_m for way in out)
    large = [way for way in out if way.size_m >= least_m]
    return tuple(large[:: -(-len(large) // MOST_PATHS)])


def _similarity(library: Library) -> Similarity:
    first: dict[str, int] = {}
    for j, i in enumerate(library.owner):
        first.setdefault(library.candidates[i].cause, j)
    columns = library.columns[:, list(first.values())]
    norm = np.sqrt((columns**2).sum(axis=0))
    unit = columns / np.where(norm > 0.0, norm, np.nan)
    return Similarity(tuple(first), unit.T @ unit)


def _range(log: MeasuredLog, stages: Sequence[MemberStage]) -> FittedIn:
    """Return the range of what happened in the log: beyond it nothing is known."""
    moved: dict[str, Array] = {}
    for p in stages:
        moved |= p.problem.stage.signals(
            p.judged.point.model.terms, p.judged.point.poses
        )
    measured = {name: log[name].values for name in (*SPEEDS, VOLTAGE) if name in log}

    def ends(of: Mapping[str, Array], *names: str) -> tuple[float, float] | None:
        found = [of[name] for name in names if name in of]
        both = np.concatenate(found) if found else None
        return None if both is None else (float(both.min()), float(both.max()))

    return FittedIn(
        speed_m_s=ends(moved, FORWARD),
        wheel_speed_rpm=ends(measured, *SPEEDS),
        turn_rate_rad_s=ends(moved, TURN),
        voltage_v=ends(measured, VOLTAGE),
    )
