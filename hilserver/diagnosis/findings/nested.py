"""The cross-validated gain: selection, noise and fit leave out the blocks that judge them.

Refitting the parameters alone would be too favourable: a selection that has seen a block has also
chosen causes for what is chance there.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.decide.predicting import halfway
from hilserver.diagnosis.decide.revision import Judged, revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.findings.estimate import estimate_of
from hilserver.diagnosis.findings.outcome import named_findings
from hilserver.diagnosis.findings.worth import Answer, Explained, Part, Predictions
from hilserver.diagnosis.regression.fitting import fit_without
from hilserver.diagnosis.regression.gain import of_halves
from hilserver.diagnosis.regression.stages import without
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.findings import Finding

Halves = Sequence[Judged | None]
"""What is found without each half of the blocks; None if nothing is left."""


def answers_of(judged: Mapping[str, Judged], seed: int, jobs: int) -> list[Answer]:
    """Return the answer of each stage of one member."""
    halves, answers = judged_by_halves(judged, seed, jobs), []
    for name, j in judged.items():
        mine, problem = halves.get(name, ()), j.prepared.problem
        before = problem.point(Model(), j.point.poses).predicted
        whole = named = cross_validated(j, mine, before)
        if any(half is not None and half.whole is not half.point for half in mine):
            named = cross_validated(j, mine, before, named=True)
        estimate = estimate_of(problem, j.point)
        found = tuple(in_halves(finding, mine) for finding in named_findings(j))
        answers.append(Answer(whole, named, j.point.model, found, estimate))
    return answers


def in_halves(finding: Finding, halves: Halves) -> Finding:
    """Return a finding with the number of halves that show it, or a cause that may stand for it."""
    shown = [h is not None and not {*finding.causes}.isdisjoint(h.whole.model.causes)
             for h in halves]  # fmt: skip
    return finding.model_copy(update={"halves": sum(shown)})


def judged_by_halves(judged: Mapping[str, Judged], seed: int, jobs: int) -> dict[str, Halves]:
    """Return, for every stage with a cause, what is found in it without each half of its blocks.

    The wheels that move the pose turn according to the drive's causes in the whole log.
    """
    found: dict[str, list[Judged | None]] = {
        name: [] for name, j in judged.items() if j.whole.model.fitted
    }
    for half in range(2 if found else 0):
        rng = np.random.default_rng(seed)
        prepared = {name: without(j.prepared, half) for name, j in judged.items()}
        scores = {n: p.library.scores(p.base) for n, p in prepared.items() if p is not None}
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
    j: Judged, halves: Halves, configured: Array, *, named: bool = False
) -> Explained:
    """Return what the causes of a stage explain of blocks that had no part in choosing them.

    Parameters
    ----------
    configured : ndarray, shape (n,)
        What the configured plant predicts.
    named : bool
        Only the causes that have a name, fitted without the others.
    """
    problem, poses = j.prepared.problem, j.point.poses
    names = [
        {f.candidate.cause, *(r.candidate.cause for r in j.ties.get(f.candidate.cause, ()))}
        for f in j.point.model.fitted
    ]

    def by_halves(barred: set[str]) -> list[Model]:
        both = halves or (None, None)
        return [Model() if half is None else _model(half, barred, named) for half in both]

    def predicted(models: Sequence[Model]) -> Array:
        each = [
            problem.point(model, poses, pose_steps=2).predicted if model.fitted else configured
            for model in models
        ]
        return of_halves(problem, each)

    def without_some(causes: frozenset[int]) -> Predictions:
        return (predicted(by_halves(set().union(*(names[i] for i in causes)))),)

    found = by_halves(set())
    of_log = [model.without(*model.of_the_machine) for model in found]
    part = Part("", j, configured, predicted(of_log), predicted(found))
    return Explained((part,), without_some)


def _model(half: Judged, barred: set[str], named: bool) -> Model:
    """Return what a half found, refitted without some causes."""
    point = half.point if named else half.whole
    gone = [i for i, cause in enumerate(point.model.causes) if cause in barred]
    if not gone:
        return point.model
    problem = half.prepared.problem
    return halfway(problem, fit_without(problem, point, *gone)).model
