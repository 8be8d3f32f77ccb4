"""Forward selection with held-out blocks, joint refit, and a swap check against every rival."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from types import MappingProxyType
from typing import Final

import numpy as np
from scipy.special import ndtr

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.decide.beginning import Terms, begun
from hilserver.diagnosis.decide.delays import beginning_for, with_other_delays
from hilserver.diagnosis.decide.promise import ModelExchange
from hilserver.diagnosis.decide.shape_search import refined, searched
from hilserver.diagnosis.decide.trial import (
    Trial,
    at_bound,
    holds,
    implausible,
    own_error,
    physical,
    possible,
    wald,
    worth_a_name,
)
from hilserver.diagnosis.noise.whitening import NoiseModel
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.screen import (
    Scores,
    adjusted,
    critical,
    null_maxima,
)
from hilserver.diagnosis.regression.stages import clean
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.schema.decisions import Decision
from hilserver.diagnosis.thresholds import (
    GROUP_COSINE,
    LEAST_GAIN,
    SCREEN_LEVEL,
    SELECTION_LEAST_SAVED,
    SELECTION_MOST_CAUSES,
    TIE,
)

TRIALS: Final = 8  # candidates fitted per round: those with the largest linear gains
MOST_FITTED: Final = 3  # causes fitted in full per round, each with all its shapes
MOST_SHAPES: Final = 4  # shapes of a cause fitted where much is left to explain
TOO_LARGE: Final = "implausibly large; other causes explain as much"
DETOUR: Final = "fewer causes explain as much without the first choice"
ROUNDS: Final = 3  # each removes more than half of the weights' bias to earlier fits


@dataclass
class Selected:
    """The outcome of one stage."""

    point: Point
    # family-wise p of each accepted cause when it was accepted
    p: dict[str, float] = field(default_factory=dict)
    # what was taken and refused, in order
    rows: list[Decision] = field(default_factory=list)
    # for each accepted cause, the others that explained nearly as much in its round
    near: dict[str, list[Trial]] = field(default_factory=dict)


def best_starts(
    scores: Scores, library: Library, barred: frozenset[str], *, gross: bool = False
) -> list[tuple[int, float]]:
    """Return the candidates that could explain most, with their linear gain; one per cause.

    Where much is left to explain, no cause is linear any more: significance is then tested on the
    fit, not on the screen, and several shapes of a cause are tried.
    """
    found: dict[str, tuple[int, float]] = {}
    shapes: dict[int, float] = {}
    for j, owner in enumerate(library.owner):
        c, gain = library.candidates[owner], float(scores.gain[j])
        weak = gain < LEAST_GAIN or (not c.linear and scores.size[j] < 0.15)
        if c.cause in barred or weak:
            continue
        if gross and c.moved is not None:
            shapes[int(owner)] = max(gain, shapes.get(int(owner), 0.0))
        if c.cause not in found or gain > found[c.cause][1]:
            found[c.cause] = (int(owner), gain)
    out = sorted(found.values(), key=lambda item: -item[1])[:TRIALS]
    more = sorted(shapes.items(), key=lambda item: -item[1])[:MOST_SHAPES]
    return out + [item for item in more if item[0] not in {index for index, _ in out}]


def attempt(
    problem: Problem,
    point: Point,
    library: Library,
    index: int,
    p: float,
    *,
    gross: bool = False,
) -> Trial | None:
    """Fit a candidate together with the accepted causes.

    One that is too small for a name competes as well: without it, a rival would be named for what
    it explains.

    Parameters
    ----------
    gross : bool
        Whether so much is left that the linear screen is a poor start.
    """
    c = library.candidates[index]
    begin = c.beginning
    if gross and not c.linear:
        c, begin = searched(
            problem, point, [o for o in library.candidates if o.cause == c.cause]
        )
    trial = fit(problem, point.model.plus(c, begin), point, iterations=3)
    if not possible(trial):
        return None
    return Trial(c, trial, point.deviance - trial.deviance, p)


def both_at_once(problem: Problem, point: Point, library: Library) -> Point:
    """Return a model with the causes that an accepted one may stand for, replacing or joining it.

    It is unchanged unless one of these is clearly better, or simpler and as good.
    """
    for index, cause in enumerate(point.model.causes):
        traits = traits_of(cause)
        wanted = {*traits.together, *traits.everywhere} - set(point.model.causes)
        missing = [c for c in library.candidates if c.cause in wanted]
        if not missing:
            continue
        own, others = point.model.fitted[index], point.model.without(index).fitted
        new = [Fitted(c, beginning_for(own, c)) for c in missing]
        tried = [Model((*others, *new))]
        if traits.together:
            beside = [Fitted(c, c.beginning) for c in missing]
            tried.append(Model((*point.model.fitted, *beside)))
        for model in tried:
            trial = fit(problem, model, point, iterations=12)
            more = _weight(model) - _weight(point.model)
            saved = point.deviance - trial.deviance - TIE * more
            if more > 0:
                better = saved > SELECTION_LEAST_SAVED and holds(problem, point, trial)
            else:  # simpler: as good is enough
                harms = ModelExchange(problem, point, trial).harms
                better = saved > 0.0 and not harms
            if better and physical(trial):
                return trial
    return point


def _weight(model: Model) -> int:
    return sum(f.candidate.weight for f in model.fitted)


def select(
    problem: Problem,
    library: Library,
    base: Point,
    rng: np.random.Generator,
    jobs: int = 1,
    other: Sequence[Scores] = (),
    running: Terms = MappingProxyType({}),
) -> Selected:
    """Select the causes of a stage, in `jobs` threads.

    Parameters
    ----------
    other : sequence of Scores
        Of the other stages, which share the family-wise level.
    running : mapping of str to float
        Terms that already run: the search starts there and estimates their total values.
    """
    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        search = partial(_forward, problem, library, base, other, rng, pool, running)
        return _plausible(problem, library, base, search)


def _plausible(
    problem: Problem,
    library: Library,
    base: Point,
    search: Callable[[frozenset[str]], Selected],
) -> Selected:
    """Search; where the first choice is in doubt, search again without it.

    The first choice shapes all that follows: swapping single causes never leads from it to several
    causes that explain the data as well, nor from several that make up for it to the few that
    explain as much. A cause at a bound explains nothing at all.
    """
    beginning = problem.noise, problem.weights
    first = search(frozenset())
    excessive = [f for f in first.point.model.fitted if _excessive(f)]
    barred = frozenset(f.candidate.cause for f in excessive) or _detour(first)
    if not barred:
        return first
    own = problem.noise, problem.weights
    _use_noise(problem, library, beginning, base)
    other = search(barred)
    impossible = any(map(at_bound, excessive))
    noises = own, (problem.noise, problem.weights)
    ours, theirs = (sum(_cost(problem, s, n) for n in noises) for s in (first, other))
    if excessive:
        why, better = TOO_LARGE, impossible or theirs <= ours
    else:
        inexact = sum(_own_error(problem.under(*n), other.point, base) for n in noises)
        as_good = theirs <= ours + inexact
        why, better = DETOUR, as_good and _simpler(problem, first.point, other.point)
    if better and not any(map(_excessive, other.point.model.fitted)):
        gone = [
            c for c in first.point.model.causes if c not in other.point.model.causes
        ]
        other.rows[:0] = [Decision(cause, "swapped", None, why) for cause in gone]
        return other
    _use_noise(problem, library, own, first.point)
    if impossible:
        return Selected(problem.point(Model(), base.poses), rows=first.rows)
    return first


def _detour(selected: Selected) -> frozenset[str]:
    """Return the first choice where others may only make up for it, and what it could be taken for.

    Where wheels stick and break loose no slope leads back from several causes to fewer. Two need no
    second search: a rival that stands for both is found in the place of one. What already runs is
    no choice of the search.
    """
    causes = selected.point.model.causes
    first = next((cause for cause in selected.near if cause in causes), None)
    if first is None or len(causes) < 3:
        return frozenset()
    alike = frozenset({first, *(t.candidate.cause for t in selected.near[first])})
    return alike if any(traits_of(cause).abrupt for cause in alike) else frozenset()


def _simpler(problem: Problem, point: Point, other: Point) -> bool:
    """Return whether a model has fewer causes, no more parameters, and predicts as well."""
    (few, small), (many, large) = (
        (len(m.fitted), _weight(m)) for m in (other.model, point.model)
    )
    return (
        0 < few < many
        and small <= large
        and not ModelExchange(problem, point, other).harms
    )


def _own_error(problem: Problem, point: Point, base: Point) -> float:
    """Return what the causes may leave because their form is inexact, under the problem's noise."""
    without = problem.point(Model(), base.poses)
    return own_error(problem, problem.point(point.model, point.poses), without.deviance)


Noises = tuple[Mapping[str, NoiseModel], Array]


def _excessive(f: Fitted) -> bool:
    """Return whether a cause worth a name is at a bound, or larger than any machine has it."""
    return worth_a_name(f) and (at_bound(f) or implausible(f))


def _use_noise(problem: Problem, library: Library, noise: Noises, point: Point) -> None:
    """Use a noise model that was estimated before."""
    problem.noise, problem.weights = noise
    library.rewhiten(point)


def _cost(problem: Problem, selected: Selected, noise: Noises) -> float:
    """Return the deviance of a model under some noise, plus the cost of its parameters."""
    point = fit(
        problem.under(*noise), selected.point.model, selected.point, iterations=2
    )
    return point.deviance + TIE * _weight(point.model)


def _forward(
    problem: Problem,
    library: Library,
    point: Point,
    other: Sequence[Scores],
    rng: np.random.Generator,
    pool: ThreadPoolExecutor,
    running: Terms,
    barred: frozenset[str],
) -> Selected:
    selected, start = Selected(point), point
    if running:
        point = _already(
            problem, library, begun(problem, library, point, running, barred), selected
        )
    for _ in range(SELECTION_MOST_CAUSES):
        scores = library.scores(point)
        maxima = null_maxima([scores, *other], rng)
        limit = critical(maxima)
        if np.abs(scores.t).max(initial=0.0) < limit and not point.is_gross:
            break
        starts = best_starts(scores, library, barred, gross=point.is_gross)
        ts = [
            float(np.abs(scores.t[library.owner == index]).max()) for index, _ in starts
        ]
        ps = adjusted(np.array(ts), maxima).tolist()
        tried = pool.map(
            partial(attempt, problem, point, library, gross=point.is_gross),
            [index for index, _ in starts],
            ps,
        )
        trials = [trial for trial in tried if trial is not None]
        least = max(LEAST_GAIN, own_error(problem, point, start.deviance))
        best = refined(problem, point, trials, pool)
        accepted = _accepted(problem, point, best, least, limit, selected)
        if accepted is None:
            break
        near = [t for t in best if t.gain > GROUP_COSINE**2 * accepted.gain]
        selected.near[accepted.candidate.cause] = near
        point = both_at_once(problem, accepted.point, library)
        point = with_other_delays(library, point, selected.rows)
        for cause in point.model.causes:
            selected.p.setdefault(cause, min(accepted.p, SCREEN_LEVEL))
        point = with_noise_anew(problem, library, point)
    # samples that a fit misses get less weight, which confirms the fit: values come out too small
    for _ in range(ROUNDS if problem.is_short and point.model.fitted else 0):
        point = with_noise_anew(problem, library, point)
    selected.point = point
    return selected


def _already(
    problem: Problem, library: Library, point: Point, selected: Selected
) -> Point:
    """Return a model that a search starts from; its causes count as taken, each with its own p."""
    if not point.model.fitted:
        return point
    point = with_noise_anew(problem, library, point)
    for index, cause in enumerate(point.model.causes):
        z = wald(problem, point, index)
        selected.p[cause] = 2.0 * float(ndtr(-z))
        why = f"already active, {z:.1f} standard errors from zero"
        selected.rows.append(Decision(cause, "taken", None, why))
    return point


def _accepted(
    problem: Problem,
    point: Point,
    trials: Sequence[Trial],
    least: float,
    limit: float,
    selected: Selected,
) -> Trial | None:
    """Return the best trial that is significant and holds on blocks it was not fitted to.

    A trial that explains only part of what a better one does is a wrong name for it, even where the
    better one shows in too few blocks to be believed.
    """
    causes: set[str] = set()
    unsure: list[Trial] = []
    for trial in trials:
        causes.add(trial.candidate.cause)
        if len(causes) > MOST_FITTED:
            break
        iterations = 12 if trial.point.is_gross else 4
        fitted = fit(problem, trial.point.model, trial.point, iterations=iterations)
        z = wald(problem, fitted, len(fitted.model.fitted) - 1)
        saved = f"saves {trial.gain:.0f} of a deviance of {point.deviance:.0f}"
        cause, why = trial.candidate.cause, None
        if trial.gain <= least:
            why = f"{saved}, too little"
        elif z <= limit:
            why = f"{saved}, but only {z:.1f} standard errors from zero; {limit:.1f} are needed"
            unsure.append(replace(trial, point=fitted))
        elif not holds(problem, point, fitted):
            why = f"{saved}, but not on held-out blocks"
        elif any(_part_of(problem, other, trial, least) for other in unsure):
            why = (
                f"{saved}, but hardly any next to a cause that saves more but shows in too"
                " few blocks"
            )
        if why is None:
            why = f"{saved}, {z:.1f} standard errors from zero"
            gain = ModelExchange(problem, point, fitted).gain
            selected.rows.append(Decision(cause, "taken", gain, why))
            return replace(trial, point=fitted)
        selected.rows.append(Decision(cause, "refused", None, why))
    return None


def _part_of(problem: Problem, other: Trial, trial: Trial, least: float) -> bool:
    """Return whether another cause explains clearly more, and this one hardly adds to it."""
    if trial.gain > GROUP_COSINE**2 * other.gain:
        return False
    model = other.point.model.plus(trial.candidate, trial.theta)
    both = fit(problem, model, other.point, iterations=4)
    return other.point.deviance - both.deviance <= least


def with_noise_anew(problem: Problem, library: Library, point: Point) -> Point:
    """Estimate the noise again from what the extended model leaves, and fit once more.

    In short segments only from what no further cause could explain, which favours no model.
    """
    if problem.is_short:
        clean(problem, library, point)
    else:
        problem.estimate_noise(problem.residual(point.predicted))
    library.rewhiten(point)
    return fit(problem, point.model, point, iterations=3)
