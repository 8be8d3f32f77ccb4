"""The cross-validated gain: selection, noise and fit leave out the blocks that judge them.

Refitting the parameters alone would be too favourable: a selection that has seen a block has also
chosen causes for what is chance there.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.decide.effective import recurs, same_sign
from hilserver.diagnosis.decide.predicting import halfway
from hilserver.diagnosis.decide.promise import falls
from hilserver.diagnosis.decide.revision import JudgedStage, revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.findings.estimate import estimate_of
from hilserver.diagnosis.findings.naming import named_findings
from hilserver.diagnosis.findings.worth import (
    Explained,
    MemberStage,
    Predictions,
    StageAnswer,
)
from hilserver.diagnosis.regression.fitting import fit_without
from hilserver.diagnosis.regression.gain import HORIZON_S, of_halves
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.stages import without
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.decisions import Decision
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import GROUP_COSINE

NONE: Final[frozenset[str]] = frozenset()
Halves = Sequence[JudgedStage | None]
"""What is found without each half of the blocks; None if nothing is left."""


def answers_of(
    judged: Mapping[str, JudgedStage], seed: int, jobs: int
) -> list[StageAnswer]:
    """Return the answer of each stage of one member."""
    halves, answers = judged_by_halves(judged, seed, jobs), []
    for name, one in judged.items():
        mine, problem = halves.get(name, ()), one.prepared.problem
        before = problem.point(Model(), one.point.poses).predicted
        j = confirmed(one, mine, before)
        whole = patched = cross_validated(j, mine, before)
        found = [half for half in mine if half is not None]
        if any(half.whole is not half.point or half.effective for half in found):
            patched = cross_validated(j, mine, before, patched=True)
        estimate = estimate_of(problem, j.point)
        findings = tuple(in_halves(finding, mine) for finding in named_findings(j))
        answers.append(StageAnswer(whole, patched, j.point.model, findings, estimate))
    return answers


def confirmed(j: JudgedStage, halves: Halves, configured: Array) -> JudgedStage:
    """Return a stage with those effective items that each half finds and both together confirm.

    The others stay in what predicts, without a claim.
    """
    if not j.effective:
        return j
    problem = j.prepared.problem
    alike = {}
    for index, cause in enumerate(j.point.model.causes):
        if cause in j.effective:
            found = [_alike(problem, j.point, index, half) for half in halves]
            alike[cause] = frozenset().union(*found) if found and all(found) else NONE
    j = replace(j, alike=alike)
    whole = cross_validated(j, halves, configured)
    gone: list[int] = []
    for index, cause in enumerate(j.point.model.causes):
        why = None
        if cause not in j.effective:
            continue
        if not alike[cause]:
            why = "one half of the log does not find it"
        elif not recurs(problem, j.point, index):
            why = "another part of the log may not show it"
        elif not _gains(index, whole):
            why = "it gains nothing where it was not fitted"
        if why is not None:
            gone.append(index)
            j.selected.rows.append(Decision(cause, "dropped", None, f"no claim: {why}"))
    if not gone:
        return j
    point = fit_without(problem, j.point, *gone)
    return replace(j, point=point, effective=j.effective & {*point.model.causes})


def _alike(
    problem: Problem, point: Point, index: int, half: JudgedStage | None
) -> frozenset[str]:
    """Return what half of the log finds that does the same as an item, under whatever name."""
    theirs = half.whole.model if half is not None else Model()
    own, item = problem.effect(point, index), point.model.fitted[index]
    found = set()
    for at, other in enumerate(theirs.fitted):
        cause = other.candidate.cause
        if cause == item.candidate.cause and same_sign((item, other)):
            found.add(cause)
            continue
        shown, without = (
            problem.predict(model.terms, point.poses)
            for model in (theirs, theirs.without(at))
        )
        effect = problem.shown(point, problem.stage.difference(shown, without))
        if own @ effect > GROUP_COSINE * np.sqrt((own @ own) * (effect @ effect)):
            found.add(cause)
    return frozenset(found)


def _gains(index: int, whole: Explained) -> bool:
    """Return whether an item makes predictions better where it had no part in selection and fit."""
    (without,) = whole.without(frozenset({index}))
    (part,) = whole.parts
    pairs = part.errors(without, HORIZON_S)
    return any(map(falls, pairs.values()))


def in_halves(finding: Finding, halves: Halves) -> Finding:
    """Return a finding with the number of halves that show it, or a cause that may stand for it."""
    shown = [h is not None and not {*finding.causes}.isdisjoint(h.whole.model.causes)
             for h in halves]  # fmt: skip
    return finding.model_copy(update={"halves": sum(shown)})


def judged_by_halves(
    judged: Mapping[str, JudgedStage], seed: int, jobs: int
) -> dict[str, Halves]:
    """Return, for every stage with a cause, what is found in it without each half of its blocks.

    The wheels that move the pose turn according to the drive's causes in the whole log.
    """
    found: dict[str, list[JudgedStage | None]] = {
        name: [] for name, j in judged.items() if j.whole.model.fitted
    }
    for half in range(2 if found else 0):
        rng = np.random.default_rng(seed)
        prepared = {name: without(j.prepared, half) for name, j in judged.items()}
        scores = {
            n: p.library.scores(p.base) for n, p in prepared.items() if p is not None
        }
        for name, halves in found.items():
            p = prepared[name]
            if p is None:
                halves.append(None)
                continue
            others = [s for other, s in scores.items() if other != name]
            selected = select(p.problem, p.library, p.base, rng, jobs, others)
            halves.append(revised(p, selected, rng))
    return dict(found)


def cross_validated(
    j: JudgedStage, halves: Halves, configured: Array, *, patched: bool = False
) -> Explained:
    """Return what the causes of a stage explain of blocks that had no part in choosing them.

    Parameters
    ----------
    configured : ndarray, shape (n,)
        What the configured plant predicts.
    patched : bool
        Only what the patch holds that each half forms by itself.
    """
    problem, poses = j.prepared.problem, j.point.poses
    names = [
        {
            f.candidate.cause,
            *(r.candidate.cause for r in j.ties.get(f.candidate.cause, ())),
            *j.alike.get(f.candidate.cause, ()),
        }
        for f in j.point.model.fitted
    ]

    def of_half(half: JudgedStage | None, barred: set[str]) -> Model:
        if half is None:
            return Model()
        point, gone = half.whole, barred
        if patched:  # nobody gets what only one half takes for effective
            point, gone = (
                half.point,
                barred | (half.effective - set().union(*names)),
            )
        left = [i for i, cause in enumerate(point.model.causes) if cause in gone]
        if not left:
            return point.model
        own = half.prepared.problem
        return halfway(own, fit_without(own, point, *left)).model

    def by_halves(barred: set[str]) -> list[Model]:
        return [of_half(half, barred) for half in halves or (None, None)]

    def predicted(models: Sequence[Model]) -> Array:
        each = [
            problem.point(model, poses, pose_steps=2).predicted
            if model.fitted
            else configured
            for model in models
        ]
        return of_halves(problem, each)

    def without_some(causes: frozenset[int]) -> Predictions:
        return (predicted(by_halves(set().union(*(names[i] for i in causes)))),)

    found = by_halves(set())
    of_log = [model.without(*model.of_the_machine) for model in found]
    part = MemberStage("", j, configured, predicted(of_log), predicted(found))
    return Explained((part,), without_some)
