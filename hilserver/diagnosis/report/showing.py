"""Fills the evidence: what the report draws."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG, part_of
from hilserver.diagnosis.decide.structure import Unknown
from hilserver.diagnosis.regression.gain import HORIZONS_S, compare, free_run_errors, windows
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.regression.screen import Scores, adjusted, critical, null_maxima
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.pose_stage import FORWARD, TURN
from hilserver.diagnosis.report import cuts
from hilserver.diagnosis.report.course import courses
from hilserver.diagnosis.report.dependence import dependences
from hilserver.diagnosis.schema.decisions import ScreenRow, SelectionRow
from hilserver.diagnosis.schema.evidence import (
    Course,
    Dependence,
    Evidence,
    FittedRange,
    FittedTerm,
    HorizonRow,
    NoiseRow,
    Path,
    Series,
    Similarity,
)
from hilserver.measured.arrays import Array
from hilserver.measured.channels import POSITION, SPEEDS, VOLTAGE, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.measured.names import signal_unit

MOST_PATHS = 4
"""Paths that are drawn: evenly from those that cover about as much ground as the largest."""
HALF_AS_LARGE = 0.5


@dataclass(frozen=True)
class Shown:
    """One stage with its predictions before and after the extension.

    Attributes
    ----------
    unknown : sequence of Unknown
        What the residual of `point` depends on without a name.
    drift : mapping of str to float
        Causes of `point` that change along the log, with their p.
    """

    prepared: Prepared
    point: Point
    before: Array
    after: Array
    scores: Scores
    unknown: Sequence[Unknown]
    drift: Mapping[str, float]
    selection: tuple[SelectionRow, ...] = ()


def evidence(
    log: MeasuredLog,
    stages: Mapping[str, Shown],
    terms: tuple[FittedTerm, ...],
    timings: Mapping[str, float],
) -> Evidence:
    """Collect what stands behind the findings."""
    series: list[Series] = []
    noise: list[NoiseRow] = []
    screen: list[ScreenRow] = []
    horizons: list[HorizonRow] = []
    paths: tuple[Path, ...] = ()
    similarity = None
    rest: list[Dependence] = []
    over_time: list[Course] = []
    extended = bool(terms)
    prepared = {name: s.prepared for name, s in stages.items()}
    for s in stages.values():
        series += _series(s, extended)
        noise += _noise(s)
        screen += _screen(s)
        rest += dependences(s.prepared.problem, s.point, s.unknown)
        over_time += courses(s.prepared.problem, s.point, set(s.drift))
        horizons += _horizons(s)
        paths += _paths(s, extended)
        similarity = _similarity(s)
    start_s = min((float(c.t_s[0]) for c in log.channels.values() if len(c.t_s)), default=0.0)
    return Evidence(
        series=tuple(replace(item, t_s=item.t_s - start_s) for item in series),
        paths=paths,
        cuts=cuts.cuts(prepared),
        noise=tuple(noise),
        screen=tuple(screen),
        selection=tuple(row for s in stages.values() for row in s.selection),
        similarity=similarity,
        gain_by_horizon=tuple(horizons),
        dependences=tuple(
            replace(item, x=item.x - start_s) if item.regressor == "t_s" else item for item in rest
        ),
        courses=tuple(replace(item, t_s=item.t_s - start_s) for item in over_time),
        extension=terms,
        fitted=_range(log, stages),
        timings_s=dict(timings),
        remarks=cuts.remarks(prepared),
    )


def _series(s: Shown, extended: bool) -> list[Series]:
    problem, stack = s.prepared.problem, s.prepared.problem.stack
    span = problem.stage.segments.span[stack.segment]
    first, second = problem.residual(s.before), problem.residual(s.after)
    out = []
    for name in stack.channels:
        e = stack.edges[name]
        measured = stack.values[e]
        if name == YAW:
            measured = _unwrapped(measured, span[e])
        out.append(
            Series(
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


def _unwrapped(values: Array, span: NDArray[np.int64]) -> Array:
    out = values.copy()
    for s in np.unique(span):
        out[span == s] = np.unwrap(values[span == s])
    return out


def _noise(s: Shown) -> list[NoiseRow]:
    rows = []
    for name, model in s.prepared.problem.noise.items():
        rows.append(
            NoiseRow(
                name,
                signal_unit(name),
                float(model.white_sd),
                float(model.ou_sd),
                float(model.ou_tau_s) if model.ou_sd > 0.0 else None,
                float(model.tail_dof) if np.isfinite(model.tail_dof) else None,
            )
        )
    return rows


def _screen(s: Shown) -> list[ScreenRow]:
    library = s.prepared.library
    maxima = null_maxima([s.scores], np.random.default_rng(0))
    limit = critical(maxima)
    if limit <= 0.0:  # no cause shows in such data at all
        return []
    rows: dict[str, ScreenRow] = {}
    for i, c in enumerate(library.candidates):
        mine = np.flatnonzero(library.owner == i)
        if not mine.size:
            continue
        j = int(mine[np.argmax(np.abs(s.scores.t[mine]))])
        part = next(iter(c.terms(c.start)))
        part = OF_THE_LOG.get(part, part)
        t = float(s.scores.t[j])
        if c.cause in rows and abs(rows[c.cause].statistic) >= abs(t):
            continue
        share = float(s.scores.size[j])
        value = c.null[0] + share * (1.0 if c.linear else c.start[0] - c.null[0])
        size = share * (1.0 if c.linear else abs(c.start[0] - c.null[0]))
        is_possible = not c.is_limit and c.low[0] <= value <= c.high[0]
        try:
            unit = part_of(part).unit
        except KeyError:
            unit = "1"
        rows[c.cause] = ScreenRow(
            cause=c.cause,
            part="" if part == c.cause else part.partition(".")[2],
            statistic=t,
            critical=limit,
            p_adjusted=float(adjusted(np.array([t]), maxima)[0]),
            size=size if is_possible else None,
            standard_error=abs(size / t) if t else 0.0,
            unit=unit,
            dof=float(library.problem.stack.n_blocks),
        )
    return list(rows.values())


def _horizons(s: Shown) -> list[HorizonRow]:
    rng, out = np.random.default_rng(0), []
    seen: set[float] = set()
    for horizon_s in HORIZONS_S:
        w = windows(s.prepared.problem, horizon_s)
        if w is None or round(w.horizon_s, 1) in seen:
            continue
        seen.add(round(w.horizon_s, 1))
        first, second = (free_run_errors(s.prepared.problem, p, w) for p in (s.before, s.after))
        for key in first:
            g = compare(first[key], second[key], w.horizon_s, rng)
            out.append(HorizonRow(key, g.horizon_s, g.before, g.after, g.ratio, g.ci95))
    return out


def _paths(s: Shown, extended: bool) -> tuple[Path, ...]:
    stack = s.prepared.problem.stack
    if not all(n in stack.edges for n in POSITION):
        return ()
    x, y = (stack.edges[n] for n in POSITION)
    if x.stop - x.start != y.stop - y.start:
        return ()
    segment = stack.segment[x]
    span = s.prepared.problem.stage.segments.span[segment]
    out = []
    for k in np.unique(span):
        rows = span == k
        tracks = [
            np.stack([v[x][rows], v[y][rows]], axis=1) for v in (stack.values, s.before, s.after)
        ]
        begins = tuple((np.flatnonzero(np.diff(segment[rows])) + 1).tolist())
        out.append(Path(int(k), tracks[0], tracks[1], tracks[2] if extended else None, begins))
    least_m = HALF_AS_LARGE * max(way.size_m for way in out)
    large = [way for way in out if way.size_m >= least_m]
    return tuple(large[:: -(-len(large) // MOST_PATHS)])


def _similarity(s: Shown) -> Similarity:
    library = s.prepared.library
    first: dict[str, int] = {}
    for j, i in enumerate(library.owner):
        first.setdefault(library.candidates[i].cause, j)
    columns = library.columns[:, list(first.values())]
    norm = np.sqrt((columns**2).sum(axis=0))
    unit = columns / np.where(norm > 0.0, norm, np.nan)
    return Similarity(tuple(first), unit.T @ unit)


def _range(log: MeasuredLog, stages: Mapping[str, Shown]) -> FittedRange:
    """Return the range of what happened in the log: outside of it nothing is known."""
    moved: dict[str, Array] = {}
    for s in stages.values():
        moved |= s.prepared.problem.stage.signals(s.point.model.terms, s.point.poses)
    measured = {name: log[name].values for name in (*SPEEDS, VOLTAGE) if name in log}

    def ends(of: Mapping[str, Array], *names: str) -> tuple[float, float] | None:
        found = [of[name] for name in names if name in of]
        both = np.concatenate(found) if found else None
        return None if both is None else (float(both.min()), float(both.max()))

    return FittedRange(
        ends(moved, FORWARD),
        ends(measured, *SPEEDS),
        ends(moved, TURN),
        ends(measured, VOLTAGE),
    )
