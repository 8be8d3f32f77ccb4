"""From selected causes to what is told: rivals, superfluous causes, unknown structure, drift."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hilserver.diagnosis.anchors import Anchor, anchor_off
from hilserver.diagnosis.decisions import SelectionRow
from hilserver.diagnosis.drift import with_drift
from hilserver.diagnosis.identifiability import Rival, prune, settle
from hilserver.diagnosis.model import Model
from hilserver.diagnosis.problem import Point, fit
from hilserver.diagnosis.screen import GROSS, Scores
from hilserver.diagnosis.scrubbing import bent_turn, late_turn, scrubs
from hilserver.diagnosis.selection import Selected
from hilserver.diagnosis.stages import Prepared
from hilserver.diagnosis.structure import (
    Unknown,
    families_of,
    imitated,
    misplaced,
    remaining,
    without_unknown,
)
from hilserver.diagnosis.trial import worth_a_name

LEAST_GAIN = 10.0
LEFT_SHARE = 0.1


@dataclass
class Judged:
    """One stage after selection."""

    prepared: Prepared
    selected: Selected
    point: Point
    ties: Mapping[str, list[Rival]]
    unknown: list[Unknown]
    drift: dict[str, float]
    scores: Scores
    scrubs: bool
    anchor: Anchor | None = None


def settled(p: Prepared, selected: Selected, rng: np.random.Generator) -> Judged:
    """Weigh the selected causes against rivals, each other and unknown structure."""
    problem, point, rows = p.problem, selected.point, selected.rows
    ties: dict[str, list[Rival]] = {}
    if point.model.fitted:
        exchanged, ties = settle(p.library, point, selected.near)
        rows += _left_out(point, exchanged, "swapped", "a rival explains the data better")
        point = prune(problem, exchanged, LEAST_GAIN)
        rows += _left_out(exchanged, point, "dropped", "the others have made it superfluous")
    explained = max(p.base.deviance - point.deviance, 0.0)
    unknown = remaining(problem, point, rng, families_of(problem, point), explained)
    doubtful = set(without_unknown(problem, point, unknown))
    if point.model.fitted:
        doubtful |= set(imitated(problem, point, families_of(problem, point)))
        doubtful |= set(misplaced(problem, point))
    for index in sorted(doubtful, reverse=True):
        less = fit(problem, point.model.without(index), point, iterations=3)
        rows += _left_out(point, less, "dropped", "unknown structure explains as much")
        point = less
    if unknown or doubtful:
        unknown = remaining(problem, point, rng, families_of(problem, point), 0.0) or unknown
    drift: dict[str, float] = {}
    changing = with_drift(p.library, point, rng)
    left = point.deviance - changing.gain
    clear = problem.stage.name != "drive" or left < GROSS * len(point.left)
    if changing.p and clear and changing.gain > max((u.gain for u in unknown), default=0.0):
        why = "another cause changes along the log"
        rows += _left_out(point, changing.point, "dropped", why)
        point, drift, unknown = changing.point, changing.p, []
    for index in reversed(range(len(point.model.fitted))):
        if not worth_a_name(point.model.fitted[index]):
            less = fit(problem, point.model.without(index), point, iterations=3)
            rows += _left_out(point, less, "dropped", "too small to be worth a name")
            point = less
    if not drift and fails(p, point):
        rows += _left_out(point, p.base, "dropped", "far more remains than it explains")
        point, unknown = problem.point(Model(), p.base.poses), []
    if not point.model.fitted and not unknown:  # a gross misfit is never left without a word
        unknown = remaining(problem, point, rng, families_of(problem, point), 0.0)
    scrubbed = scrubs(problem, point, unknown)
    while scrubbed and (late := late_turn(point)) is not None:
        less = fit(problem, point.model.without(late), point, iterations=3)
        rows += _left_out(point, less, "dropped", "tyres that scrub make the turn late as well")
        point = less
    while scrubbed and (bent := bent_turn(problem, point, explained)) is not None:
        less = fit(problem, point.model.without(bent), point, iterations=3)
        rows += _left_out(point, less, "dropped", "tyres that scrub bend the turn as well")
        point = less
    anchor = None if drift or scrubbed else anchor_off(p.library, point, unknown, rng, explained)
    if anchor is not None:
        unknown = []
    kept = {c: t for c, t in ties.items() if c in point.model.causes}
    scores = p.library.scores(p.base)
    return Judged(p, selected, point, kept, unknown, drift, scores, scrubbed, anchor)


def fails(p: Prepared, point: Point) -> bool:
    """Return whether causes of the drive leave a gross misfit, and no small part of all there was.

    Sensors of the drive have no memory: what is left then is no noise, and whatever makes it may
    well make the rest, too.
    """
    gross = point.deviance > GROSS * len(point.left)
    if p.problem.stage.name != "drive" or not point.model.fitted or not gross:
        return False
    return point.deviance > LEFT_SHARE * p.problem.point(Model(), p.base.poses).deviance


def _left_out(before: Point, after: Point, action: str, reason: str) -> list[SelectionRow]:
    """Return a row for each cause that one model has and the next has not."""
    gone = [c for c in before.model.causes if c not in after.model.causes]
    return [SelectionRow(cause, action, None, reason) for cause in gone]
