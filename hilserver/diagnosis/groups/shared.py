"""What groups of logs share: each stage of all of them as one model, fitted together.

Every group is examined on its own: its data faults, its noise, the causes its logs show. The causes
of all groups form one model, which is fitted to all of them; each of its parameters is shared by
the groups, or free where they differ.
"""

from collections.abc import Sequence

import numpy as np

from hilserver.diagnosis.catalogue.candidate import STAGES
from hilserver.diagnosis.examine import Member
from hilserver.diagnosis.findings.estimate import StageEstimate
from hilserver.diagnosis.findings.worth import (
    Explained,
    MemberStage,
    Predictions,
    StageAnswer,
)
from hilserver.diagnosis.groups.deciding import Decided, decided, with_what_remains
from hilserver.diagnosis.groups.finding import estimate_in_groups, fitted_findings
from hilserver.diagnosis.groups.joint_fit import fit_in_all
from hilserver.diagnosis.regression.gain import pooled_gains
from hilserver.diagnosis.replay.judgeable import UNSEEN, absent, vocabulary_reasons
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.findings import Detectable, Gain, NotJudged


def answers_in_groups(members: Sequence[Member], seed: int) -> list[StageAnswer]:
    """Return the answer of each stage of all groups."""
    answers = []
    for stage in STAGES:
        if judged := {m.name: m.judged[stage] for m in members if stage in m.judged}:
            whole = with_what_remains(decided(judged), np.random.default_rng(seed))
            answers.append(_answer(whole))
    return answers


def _answer(d: Decided) -> StageAnswer:
    explained, joint = _explained(d), d.joint
    if joint is None:
        return StageAnswer(explained, explained, Model(), (), StageEstimate.none())
    estimate = estimate_in_groups(joint, d.names)
    return StageAnswer(
        explained, explained, joint.model(0), fitted_findings(d), estimate
    )


def _explained(d: Decided) -> Explained:
    """Return what the causes of one stage explain in all groups."""
    fitted = d.joint
    configured = tuple(
        j.prepared.problem.point(Model(), j.point.poses).predicted for j in d.members
    )
    corrected = after = configured
    if fitted is not None:
        machine, after = fitted.points[0].model.of_the_machine, fitted.held_out()
        if len(machine) < len(d.causes):
            corrected = fitted.held_out(machine)

    def without(causes: frozenset[int]) -> Predictions:
        assert fitted is not None
        if len(causes) == len(fitted.points[0].model.fitted):
            return configured
        models = [point.model.without(*causes) for point in fitted.points]
        slices = fitted.points[0].model.slices
        gone = [
            i
            for cause in causes
            for i in range(slices[cause].start, slices[cause].stop)
        ]
        return fit_in_all(
            d.members, models, np.delete(fitted.all.free, gone)
        ).held_out()

    parts = zip(d.names, d.members, configured, corrected, after, strict=True)
    return Explained(tuple(MemberStage(*part) for part in parts), without)


def gains_in_groups(
    answers: Sequence[StageAnswer], horizon_s: float, rng: np.random.Generator
) -> tuple[dict[str, Gain], dict[str, dict[str, Gain]]]:
    """Return the gain over all groups, and that of each group."""
    total: dict[str, Gain] = {}
    by_group: dict[str, dict[str, Gain]] = {}
    for answer in answers:
        for part in answer.patch.parts:
            own = pooled_gains([part.errors(part.corrected, horizon_s)], rng)
            by_group[part.member] = by_group.get(part.member, {}) | own
        total |= answer.patch.gains(horizon_s, rng, answer.patch.corrected)
    return total, by_group


def smallest_in_groups(
    members: Sequence[Member], seed: int
) -> tuple[list[Detectable], list[NotJudged]]:
    """Return the smallest effect per cause, from the group that would have shown it best."""
    sizes: dict[str, Detectable] = {}
    unseen: dict[str, NotJudged] = {}
    for m in members:
        own, not_excited = m.smallest(np.random.default_rng(seed))
        for size in own:
            if size.cause not in sizes or size.size < sizes[size.cause].size:
                sizes[size.cause] = size
        unseen |= {one.cause: one for one in not_excited}
        why = vocabulary_reasons(
            {d.cause for d in own}, m.reasons, set(m.judged), absent(m.log), UNSEEN
        )
        unseen |= {
            c: NotJudged(cause=c, reason=r) for c, r in why.items() if c not in unseen
        }
    return list(sizes.values()), [
        one for cause, one in unseen.items() if cause not in sizes
    ]
