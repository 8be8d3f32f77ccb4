"""From selected causes to findings: rivals, superfluous causes, unknown structure, drift."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.decide.anchors import Anchor, anchor_off, scale_or_anchor
from hilserver.diagnosis.decide.drift import changing_alike, with_drift
from hilserver.diagnosis.decide.effective import with_effective
from hilserver.diagnosis.decide.identifiability import Rival, prune, with_best_rivals
from hilserver.diagnosis.decide.predicting import (
    before_settling,
    halfway,
    with_nameless,
)
from hilserver.diagnosis.decide.promise import ModelExchange, left_out
from hilserver.diagnosis.decide.scrubbing import bent_turn, late_turn, may_scrub, scrubs
from hilserver.diagnosis.decide.selection import Selected, with_noise_anew
from hilserver.diagnosis.decide.structure import (
    Imitation,
    Unknown,
    beside_structure,
    imitated,
    remaining,
    without_unknown,
)
from hilserver.diagnosis.decide.trial import at_bound, implausible, worth_a_name
from hilserver.diagnosis.decide.unknown import families_of
from hilserver.diagnosis.regression.fitting import fit_without
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.screen import Scores
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.schema.decisions import Decision
from hilserver.diagnosis.thresholds import GROSS, LEAST_GAIN, LEFT_SHARE, TIE

BY_STRUCTURE: Final = "unknown structure explains as much"
TOO_SMALL: Final = "too small to be worth a name"
Doubt = tuple[int, str] | None
"""The index of a cause that should go, and why; None if there is none."""


@dataclass
class JudgedStage:
    """One stage after selection."""

    prepared: Prepared
    selected: Selected
    point: Point  # what a patch can hold: causes with a name, and effective items
    whole: Point
    """What predicts: these, and columns of causes that proved right but lost their names."""
    ties: Mapping[str, list[Rival]]
    unknown: list[Unknown]
    drift: dict[str, float]
    scores: Scores
    scrubs: bool  # a rotation gain may be friction across the wheels
    anchor: tuple[Anchor, float] | None = None  # an anchor that is off, and its p
    in_doubt: Anchor | None = None
    """An anchor that could replace an accepted scale of the navigation."""
    effective: frozenset[str] = frozenset()  # items of `point` that assert no cause
    # by effective item: the causes as which halves of the log find it
    alike: Mapping[str, frozenset[str]] = field(default_factory=dict)

    @property
    def lasting(self) -> Model:
        """The causes with one value for the whole log: without those that change along it."""
        fitted = self.point.model.fitted
        return Model(tuple(f for f in fitted if f.candidate.cause not in self.drift))


def revised(p: Prepared, selected: Selected, rng: np.random.Generator) -> JudgedStage:
    """Weigh the selected causes against rivals, each other and unknown structure."""
    problem, rows = p.problem, selected.rows
    weighed, ties = _weighed(p, selected)
    explained = (
        max(p.base.deviance - weighed.deviance, 0.0) if weighed.model.fitted else 0.0
    )
    point, unknown = _beside_structure(problem, weighed, explained, rng, rows)
    point, unknown, drift = _changing(p, point, unknown, rng, rows)
    fitted, (point, is_missed) = point, _named_only(problem, point, ties, drift, rows)
    drift = {cause: p for cause, p in drift.items() if cause in point.model.causes}
    bare = point is not fitted and not point.model.fitted
    # without them the misfit is no less gross
    if is_missed or (bare and not unknown and fitted.is_gross):
        unknown = _remaining(problem, point, rng, 0.0 if bare else explained)
    if not drift and fails(p, point, unknown):
        rows += left_out(
            problem,
            point,
            p.base,
            "dropped",
            "much more error remains than it explains",
        )
        point = problem.point(Model(), p.base.poses)
        unknown = _remaining(problem, point, rng, 0.0)
    scrubbed = scrubs(problem, point, unknown)
    if scrubbed:
        point = _without_what_tyres_do(problem, point, explained, rows)
    anchor = (
        None
        if drift or scrubbed
        else anchor_off(p.library, point, unknown, rng, explained)
    )
    if anchor is not None:
        unknown = []
    last = None if drift else scale_or_anchor(problem, point)
    in_doubt = last.anchor if last is not None and abs(last.more) <= TIE else None
    kept = {
        c: changing_alike(problem, point, found) if c in drift else found
        for c, found in ties.items()
        if c in point.model.causes
    }
    scores = p.library.scores(p.base)
    whole = before_settling(problem, point, (weighed, selected.point), rows)
    effective: frozenset[str] = frozenset()
    if not drift:
        whole = with_nameless(p, whole, rows)
        point, effective = with_effective(p, point, whole, rng, rows)
    rivals = [rival.fitted for found in kept.values() for rival in found]
    scrubbed = scrubbed or may_scrub(p.library, point, rivals)
    patched = halfway(problem, point)
    whole = patched if whole is point else halfway(problem, whole)
    return JudgedStage(
        p, selected, patched, whole, kept, unknown, drift, scores, scrubbed, anchor, in_doubt,
        effective,
    )  # fmt: skip


def _remaining(
    problem: Problem, point: Point, rng: np.random.Generator, explained: float
) -> list[Unknown]:
    return remaining(problem, point, rng, families_of(problem, point), explained)


def _beside_structure(
    problem: Problem,
    weighed: Point,
    explained: float,
    rng: np.random.Generator,
    rows: list[Decision],
) -> tuple[Point, list[Unknown]]:
    """Return a model without causes that unknown structure replaces, and that structure."""
    point, look = weighed, Imitation(problem, weighed)
    families = look.beside(families_of(problem, weighed))
    unknown = remaining(problem, weighed, rng, families, explained)
    doubtful = _harmless(problem, point, without_unknown(problem, point, unknown))
    contest = scale_or_anchor(problem, point)
    doubtful |= {contest.scale} if contest is not None and contest.more > TIE else set()
    for index in sorted(doubtful, reverse=True):
        point = _dropped(problem, point, index, rows, BY_STRUCTURE)

    def substitute(point: Point) -> Doubt:
        known = point is weighed
        index = (
            look.index
            if known
            else imitated(problem, point, families_of(problem, point))
        )
        return None if index is None else (index, BY_STRUCTURE)

    point = _without_doubtful(problem, point, rows, substitute)
    if point is not weighed or (unknown and explained > 0.0):
        unknown = _remaining(problem, point, rng, 0.0) or unknown
    return point, unknown


def _changing(
    p: Prepared,
    point: Point,
    unknown: list[Unknown],
    rng: np.random.Generator,
    rows: list[Decision],
) -> tuple[Point, list[Unknown], dict[str, float]]:
    """Return the model in which causes change along the log, if that explains more."""
    changing = with_drift(p.library, point, rng)
    left = point.deviance - changing.gain
    clear = not p.problem.stage.memoryless or left < GROSS * len(point.left)
    if (
        changing.p
        and clear
        and changing.gain > max((u.gain for u in unknown), default=0.0)
    ):
        why = "another cause changes over the course of the log"
        rows += left_out(p.problem, point, changing.point, "dropped", why)
        return changing.point, [], changing.p
    return point, unknown, {}


def _named_only(
    problem: Problem,
    point: Point,
    ties: Mapping[str, Sequence[Rival]],
    drift: Mapping[str, float],
    rows: list[Decision],
) -> tuple[Point, bool]:
    """Return a model without causes that are no findings, and whether one of them is missed.

    One too small for a name is not: what it explained is known, and does not matter. But of one
    that changes along the log, the mean does not show how large it is.
    """

    def nameless(point: Point) -> Doubt:
        reasons = (no_name(problem, f, ties) for f in point.model.fitted)
        return next(
            ((i, reason) for i, reason in enumerate(reasons) if reason is not None),
            None,
        )

    known = len(rows)
    named = _without_doubtful(problem, point, rows, nameless)
    return named, any(
        row.reason != TOO_SMALL or row.cause in drift for row in rows[known:]
    )


def no_name(
    problem: Problem, f: Fitted, ties: Mapping[str, Sequence[Rival]]
) -> str | None:
    """Return why a fitted cause is no finding; None if it is one.

    A cause larger than any machine has may be in a group behind a plausible one.
    """
    if not worth_a_name(f):
        return TOO_SMALL
    if at_bound(f):
        return "at the bound of its range"
    cause = f.candidate.cause
    mirrored = traits_of(cause).mirrored_by and not problem.stage.robot.is_mecanum
    alone = not mirrored and all(implausible(r.fitted) for r in ties.get(cause, ()))
    return "implausibly large" if implausible(f) and alone else None


def _harmless(problem: Problem, point: Point, doubtful: Iterable[int]) -> set[int]:
    """Return those of some causes without which no held-out error grows, or one even falls.

    A family of columns is flexible enough to explain as much as a true cause on the blocks that it
    is fitted to; but a true cause does not make any prediction worse.
    """
    steps = {
        i: ModelExchange(problem, point, fit_without(problem, point, i))
        for i in doubtful
    }
    return {i for i, step in steps.items() if step.helps or not step.harms}


def _dropped(
    problem: Problem, point: Point, index: int, rows: list[Decision], reason: str
) -> Point:
    """Return a model without one of its causes."""
    less = fit_without(problem, point, index)
    rows += left_out(problem, point, less, "dropped", reason)
    return less


def _without_doubtful(
    problem: Problem,
    point: Point,
    rows: list[Decision],
    doubt: Callable[[Point], Doubt],
) -> Point:
    """Return a model without causes that should go, dropped one at a time."""
    while (found := doubt(point)) is not None:
        point = _dropped(problem, point, found[0], rows, found[1])
    return point


def _weighed(p: Prepared, selected: Selected) -> tuple[Point, dict[str, list[Rival]]]:
    """Return the selected causes, or better ones in their place, and the rivals that tie."""
    problem, point, rows = p.problem, selected.point, selected.rows
    if not point.model.fitted:
        return point, {}
    exchanged, ties = with_best_rivals(p.library, point, selected.near)
    rows += left_out(
        problem, point, exchanged, "swapped", "a rival explains the data better"
    )
    point = prune(problem, exchanged)
    rows += left_out(
        problem,
        exchanged,
        point,
        "dropped",
        "the other causes have made it unnecessary",
    )
    simpler = with_fewer(problem, point, ties)
    if simpler is None:
        return point, ties
    rows += left_out(
        problem,
        point,
        simpler,
        "swapped",
        "a rival explains the data without another cause",
    )
    return with_best_rivals(
        p.library, with_noise_anew(problem, p.library, simpler), selected.near
    )


def _without_what_tyres_do(
    problem: Problem, point: Point, explained: float, rows: list[Decision]
) -> Point:
    """Return a model without causes that imitate the scrubbing of tyres."""

    def imitates(point: Point) -> Doubt:
        if (index := late_turn(point)) is not None:
            return index, "scrubbing tyres delay the turn as well"
        if (index := bent_turn(problem, point, explained)) is not None:
            return (
                index,
                "scrubbing tyres also make the turn depend on speed and radius",
            )
        return None

    return _without_doubtful(problem, point, rows, imitates)


def with_fewer(
    problem: Problem, point: Point, ties: Mapping[str, list[Rival]]
) -> Point | None:
    """Return a model with fewer causes in which a rival that ties replaces two; or None.

    A wheel radius with a scale of the navigation has the same effect as a rotation gain alone.
    """
    if len(point.model.fitted) < 2:
        return None
    for rival in (r for found in ties.values() for r in found):
        less = prune(problem, rival.point)
        fewer = len(less.model.fitted) < len(point.model.fitted)
        stands = rival.candidate.cause in less.model.causes
        if not fewer or not stands or less.deviance >= point.deviance + LEAST_GAIN:
            continue
        if not ModelExchange(problem, point, less).harms:
            return less
    return None


def fails(p: Prepared, point: Point, unknown: Sequence[Unknown] = ()) -> bool:
    """Return whether causes leave a gross misfit that is no small part of the original one.

    What is left then is not noise, and whatever causes it may well cause the rest, too. Noise is
    learned from a misfit as well; what unknown structure explains of it is none.
    """
    if not point.model.fitted:
        return False
    noise = beside_structure(p.problem, point, unknown)
    left = float((point.left**2 / noise).sum())
    before = p.problem.point(Model(), p.base.poses).left
    return left > max(GROSS * len(noise), LEFT_SHARE * float((before**2 / noise).sum()))
