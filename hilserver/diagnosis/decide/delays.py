"""Exchange of delays: the whole source may be late, or one of its channels.

The first delay that is accepted explains part of what another would. Added to it, the other has
little left to explain; in its place it would start from zero, from where no slope leads to a long
delay. So each delay of a model is exchanged for every other, which starts from its value, and each
must be needed in addition to the others.
"""

from typing import Final

from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.decide.identifiability import MOST_SWAPS
from hilserver.diagnosis.decide.promise import left_out
from hilserver.diagnosis.decide.trial import holds, possible
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.fitting import fit, fit_without
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.decisions import Action, Decision

EXCHANGED: Final = "another delay explains the data better in its place"
SUPERFLUOUS: Final = "together with another delay it does not hold on held-out blocks"


def with_other_delays(library: Library, point: Point, rows: list[Decision]) -> Point:
    """Return the model with the delays that explain the data best, and no superfluous one."""
    problem = library.problem
    if problem.stage.memoryless:  # each time of the drive acts in its own way
        return point
    for _ in range(MOST_SWAPS):
        action: Action = "swapped"
        other, why = _exchanged(library, point), EXCHANGED
        if other is None:
            action, other, why = "dropped", _without_one(problem, point), SUPERFLUOUS
        if other is None:
            break
        rows += left_out(problem, point, other, action, why)
        point = other
    return point


def beginning_for(f: Fitted, c: Candidate) -> tuple[float, ...]:
    """Return where a candidate starts in place of a cause; a delay takes the other's value."""
    both = traits_of(f.candidate.cause).whole_ticks and traits_of(c.cause).whole_ticks
    return f.theta if both and c.low[0] < f.theta[0] < c.high[0] else c.beginning


def _delays(point: Point) -> list[int]:
    """Return the indices of the delays in a model."""
    return [
        i for i, cause in enumerate(point.model.causes) if traits_of(cause).whole_ticks
    ]


def _exchanged(library: Library, point: Point) -> Point | None:
    """Return the best model with one delay in place of another, if it is clearly better."""
    problem, best, most = library.problem, None, 0.0
    others = [
        c
        for c in library.candidates
        if c.linear
        and traits_of(c.cause).whole_ticks
        and c.cause not in point.model.causes
    ]
    for index in _delays(point):
        for c in others:
            theta = beginning_for(point.model.fitted[index], c)
            trial = fit(
                problem, point.model.swapped(index, c, theta), point, iterations=5
            )
            if not possible(trial):
                continue
            saved = point.deviance - trial.deviance
            if saved > most and holds(problem, point, trial):
                best, most = trial, saved
    return best


def _without_one(problem: Problem, point: Point) -> Point | None:
    """Return the model without a delay that the others have made superfluous, if there is one."""
    places = _delays(point)
    if len(places) < 2:
        return None
    for index in places:
        less = fit_without(problem, point, index)
        if not holds(problem, less, point):
            return less
    return None
