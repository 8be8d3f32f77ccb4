"""Forward selection with held-out blocks, joint refit, and a swap check against every rival."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.columns import Library
from hilserver.diagnosis.evidence import SelectionRow
from hilserver.diagnosis.intervals import covariance
from hilserver.diagnosis.library import Candidate
from hilserver.diagnosis.model import Fitted, Model
from hilserver.diagnosis.problem import Point, Problem, fit
from hilserver.diagnosis.screen import (
    GROSS,
    LEVEL,
    Scores,
    adjusted,
    critical,
    freedom_of,
    normal,
    null_maxima,
    orthogonal,
)

Array = NDArray[np.float64]

MOST_CAUSES = 6
TRIALS = 8
"""Candidates of a round that are fitted: those with the largest linear gain, ..."""
MOST_FITTED = 3
"""... and of these in full."""
MOST_SHAPES = 4
"""Shapes of a cause that are fitted where much is left to explain."""
PROMISING = 0.5
"""Share of the best trial's gain from which the shape of another is worth a search."""
NEARLY = 1.1
"""Variance of the whitened residual that is noise but for the noise model's own error."""
TIE = 4.0
"""Deviance within which two causes explain the data alike, per parameter."""
LEAST_LINEAR, LEAST_GAIN, LEAST_SAVED = 9.0, 10.0, 8.0
"""Deviance that a cause must save: linearly, in its fit, and on held-out blocks."""


@dataclass(frozen=True)
class Trial:
    """A candidate fitted together with what is accepted."""

    candidate: Candidate
    point: Point
    gain: float
    t: float
    p: float

    @property
    def theta(self) -> tuple[float, ...]:
        """Fitted values of the candidate's own parameters."""
        return self.point.model.fitted[-1].theta


@dataclass
class Selected:
    """The outcome of one stage.

    Attributes
    ----------
    p : mapping of str to float
        Family-wise p of each accepted cause when it was accepted.
    rows : list of SelectionRow
        What was taken and what was refused, in order.
    """

    point: Point
    p: dict[str, float] = field(default_factory=dict)
    rows: list[SelectionRow] = field(default_factory=list)


def possible(point: Point) -> bool:
    """Return whether every parameter is inside its range and not at its edge."""
    for f in point.model.fitted:
        c = f.candidate
        for value, low, high in zip(f.theta, c.low, c.high, strict=True):
            width = high - low
            margin = 1e-6 * width if np.isfinite(width) else 0.0
            if value <= low + margin or value >= high - margin:
                return False
    return True


def worth_a_name(fitted: Fitted) -> bool:
    """Return whether a cause is as large as its least size."""
    away = (abs(v - null) for v, null in zip(fitted.theta, fitted.candidate.null, strict=True))
    return max(away) >= fitted.candidate.least


def physical(point: Point) -> bool:
    """Return whether every cause is possible and worth a name."""
    return possible(point) and all(map(worth_a_name, point.model.fitted))


def holds(problem: Problem, before: Point, model: Model, start: Point) -> bool:
    """Return whether a cause improves the blocks that took no part in its fit, both ways.

    Each half of the blocks is predicted from a fit on the other: together they must improve
    clearly, and neither may get worse.
    """
    fold = problem.stack.fold
    saved = []
    for test in (0, 1):
        train = fold != test
        if not train.any() or train.all():
            return True
        without = fit(problem, before.model, before, rows=train, iterations=2)
        point = fit(problem, model, start, rows=train, iterations=2)
        part = fold == test
        saved.append(float((without.loss - point.loss)[part].sum()))
    return sum(saved) > LEAST_SAVED and min(saved) > -1.0


def best_starts(
    scores: Scores, library: Library, *, gross: bool = False
) -> list[tuple[int, float]]:
    """Return the candidates that could explain most, with their linear gain; one of each cause.

    Where much is left to explain no cause is linear any more, so significance is asked of the fit
    and not of the screen; and of a cause with a shape several are tried.
    """
    found: dict[str, tuple[int, float]] = {}
    shapes: dict[int, float] = {}
    for j, owner in enumerate(library.owner):
        c, gain = library.candidates[owner], float(scores.gain[j])
        if gain < LEAST_LINEAR or (not c.linear and scores.size[j] < 0.15):
            continue
        if gross and c.moved is not None:
            shapes[int(owner)] = max(gain, shapes.get(int(owner), 0.0))
        if c.cause not in found or gain > found[c.cause][1]:
            found[c.cause] = (int(owner), gain)
    out = sorted(found.values(), key=lambda item: -item[1])[:TRIALS]
    more = sorted(shapes.items(), key=lambda item: -item[1])[:MOST_SHAPES]
    return out + [item for item in more if item[0] not in {index for index, _ in out}]


def wald(problem: Problem, point: Point, index: int) -> float:
    """Return how far a fitted cause lies from its null, as a normal deviation.

    The blocks that tell it from the causes beside it count, see `screen.normal`.
    """
    columns = problem.accepted(point)
    assert columns is not None
    cov, _ = covariance(problem, point, columns)
    begin = sum(f.candidate.n for f in point.model.fitted[:index])
    f = point.model.fitted[index]
    part = slice(begin, begin + f.candidate.n)
    away = np.asarray(f.theta) - np.asarray(f.candidate.null)
    t = np.sqrt(max(away @ np.linalg.pinv(cov[part, part]) @ away, 0.0))
    mine = orthogonal(columns[:, part] @ away[:, None], np.delete(columns, part, axis=1))
    return float(normal(t, freedom_of(problem.stack.block_sums(mine**2)))[0])


def attempt(
    problem: Problem,
    point: Point,
    library: Library,
    index: int,
    t: float,
    p: float,
    *,
    gross: bool = False,
) -> Trial | None:
    """Fit a candidate together with the accepted causes.

    One that is too small for a name competes as well: were it refused, a rival would get the name
    of what it explains.

    Parameters
    ----------
    gross : bool
        So much is left that the screen, which is linear, knows little of where to begin.
    """
    c = library.candidates[index]
    begin = c.beginning
    if gross and not c.linear:
        c, begin = _searched(problem, point, [o for o in library.candidates if o.cause == c.cause])
    trial = fit(problem, point.model.plus(c, begin), point, iterations=3)
    if not possible(trial):
        return None
    return Trial(c, trial, point.deviance - trial.deviance, t, p)


def _searched(
    problem: Problem, point: Point, starts: Sequence[Candidate]
) -> tuple[Candidate, tuple[float, ...]]:
    """Return the best of some starts of a cause, and a value near it that is better still.

    What a delay or a limit leaves has steps: its slope says nothing of where the bottom is.
    """

    def deviance(c: Candidate, theta: float) -> float:
        value = min(max(theta, c.low[0]), c.high[0])
        return problem.point(point.model.plus(c, (value,)), point.poses).deviance

    starts = [c for c in starts if not c.linear]
    begin = [(c, theta) for c in starts for theta in c.start]
    begin += [(starts[0], theta) for theta in starts[0].tried]
    tried = [(deviance(c, theta), c, theta) for c, theta in begin]
    least, best, theta = min(tried, key=lambda item: item[0])
    null = best.null[0]
    far = theta - null if abs(null) < FAR_NULL else theta
    stride = FIRST_STRIDE
    while stride > LAST_STRIDE:
        for factor in (1.0 + stride, 1.0 / (1.0 + stride)):
            moved = theta + far * (factor - 1.0)
            found = deviance(best, moved)
            if found < least:
                least, theta, far = found, moved, far * factor
                break
        else:
            stride *= 0.4
    return best, (min(max(theta, best.low[0]), best.high[0]),)


def refined(problem: Problem, point: Point, trials: Sequence[Trial]) -> list[Trial]:
    """Search the shapes of those trials that could win with a better one; the best first.

    Where the best trial explains a gross misfit nearly whole, no shape of another can do better.
    """
    most = max((trial.gain for trial in trials), default=0.0)
    n = len(point.left)
    whole = point.deviance > GROSS * n and point.deviance - most < NEARLY * n
    least = most if whole else PROMISING * most
    out = []
    for trial in trials:
        if trial.candidate.moved is None or trial.gain < least:
            out.append(trial)
            continue
        moved = refine(problem, trial.point, len(trial.point.model.fitted) - 1)
        if possible(moved):
            candidate, gain = moved.model.fitted[-1].candidate, point.deviance - moved.deviance
            out.append(replace(trial, candidate=candidate, point=moved, gain=gain))
    return sorted(out, key=lambda trial: -(trial.gain - TIE * trial.candidate.weight))


LATE, TOGETHER = "nav_latency", ("clock_offset", "side_slip")
"""In a bend a late position lies where side slip would put it. Where the whole source is late and
the robot slips, the latency of the position alone explains part of both; from there no exchange of
one cause for another leads on."""


def both_at_once(problem: Problem, point: Point, library: Library) -> Point:
    """Return a late source and side slip in the place of a late position, or beside it.

    As it is, unless one of these is clearly better.
    """
    causes = point.model.causes
    missing = [c for c in library.candidates if c.cause in TOGETHER and c.cause not in causes]
    if LATE not in causes or not missing:
        return point
    beginnings = [(point.model.without(causes.index(LATE)), len(missing) - 1)]
    beginnings.append((point.model, len(missing) + 1))
    for beginning, added in beginnings:
        model = beginning
        for c in missing:
            model = model.plus(c, c.beginning)
        trial = fit(problem, model, point, iterations=12)
        gain = point.deviance - trial.deviance
        if gain < LEAST_SAVED + TIE * added or not physical(trial):
            continue
        if holds(problem, point, trial.model, trial):
            return trial
    return point


FAR_NULL = 1e6
"""A limit as far away as this is none: its distance from null says nothing."""
FIRST_STRIDE, LAST_STRIDE = 0.4, 0.004
SHIFTS_M = (0.6, 0.3, 0.15, 0.08, 0.04, 0.02)


def refine(problem: Problem, point: Point, index: int) -> Point:
    """Search the shape of one cause: a region's edge is moved while the deviance falls."""
    for shift_m in SHIFTS_M:
        for side in (1.0, -1.0):
            f = point.model.fitted[index]
            assert f.candidate.moved is not None
            moved = point.model.swapped(index, f.candidate.moved(side * shift_m), f.theta)
            trial = fit(problem, moved, point, iterations=2)
            if trial.deviance < point.deviance - 0.1:
                point = trial
                break
    return point


def select(
    problems: Mapping[str, Problem],
    libraries: Mapping[str, Library],
    points: Mapping[str, Point],
    rng: np.random.Generator,
) -> dict[str, Selected]:
    """Select causes, stage by stage, at one family-wise level."""
    scores = {name: lib.scores(points[name]) for name, lib in libraries.items()}
    maxima = null_maxima(list(scores.values()), rng)
    out = {}
    for name in libraries:
        other = [s for n, s in scores.items() if n != name]
        out[name] = _forward(problems[name], libraries[name], points[name], other, rng, maxima)
    return out


def _forward(
    problem: Problem,
    library: Library,
    point: Point,
    other: Sequence[Scores],
    rng: np.random.Generator,
    maxima: Array,
) -> Selected:
    selected = Selected(point)
    for round_ in range(MOST_CAUSES):
        scores = library.scores(point)
        if round_:
            maxima = null_maxima([scores, *other], rng)
        limit = critical(maxima)
        gross = point.deviance > GROSS * len(point.left)
        if np.abs(scores.t).max(initial=0.0) < limit and not gross:
            break
        trials: list[Trial] = []
        for index, _ in best_starts(scores, library, gross=gross):
            mine = np.abs(np.where(library.owner == index, scores.t, 0.0))
            t = float(mine.max())
            p = float(adjusted(np.array([t]), maxima)[0])
            trial = attempt(problem, point, library, index, t, p, gross=gross)
            if trial is not None:
                trials.append(trial)
        accepted = _accepted(problem, point, refined(problem, point, trials), limit, selected)
        if accepted is None:
            break
        point = both_at_once(problem, accepted.point, library)
        for cause in point.model.causes:
            selected.p.setdefault(cause, min(accepted.p, LEVEL))
        _refresh_noise(problem, library, point)
        point = fit(problem, point.model, point, iterations=3)
    selected.point = point
    return selected


def _accepted(
    problem: Problem, point: Point, trials: Sequence[Trial], limit: float, selected: Selected
) -> Trial | None:
    """Return the best trial that is significant and holds on blocks it was not fitted to."""
    for trial in trials[:MOST_FITTED]:
        fitted = fit(problem, trial.point.model, trial.point, iterations=4)
        z = wald(problem, fitted, len(fitted.model.fitted) - 1)
        saved = f"saves {trial.gain:.0f} of a deviance of {point.deviance:.0f}"
        cause, why = trial.candidate.cause, None
        if trial.gain <= LEAST_GAIN:
            why = f"{saved}, too little"
        elif z <= limit:
            why = f"{saved}, but lies only {z:.1f} deviations from nought; {limit:.1f} are asked"
        elif not holds(problem, point, fitted.model, fitted):
            why = f"{saved}, but not on the blocks that it was not fitted to"
        if why is None:
            why = f"{saved}, {z:.1f} deviations from nought"
            selected.rows.append(SelectionRow(cause, "taken", None, why))
            return replace(trial, point=fitted)
        selected.rows.append(SelectionRow(cause, "refused", None, why))
    return None


def _refresh_noise(problem: Problem, library: Library, point: Point) -> None:
    """Learn the noise anew from what the extended model leaves."""
    problem.learn_noise(problem.residual(point.predicted))
    library.rewhiten(point)
