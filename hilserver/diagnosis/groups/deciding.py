"""From what each group shows on its own to one model: causes, values, what is shared."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import stats

from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.decide.structure import remaining
from hilserver.diagnosis.decide.trial import at_bound, implausible, worth_a_name
from hilserver.diagnosis.decide.unknown import families_of
from hilserver.diagnosis.groups.causes import GroupCause, causes_of
from hilserver.diagnosis.groups.joint_fit import JointFit, fit_in_all
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.thresholds import LEAST_GAIN, SCREEN_LEVEL


@dataclass(frozen=True)
class Decided:
    """One stage of all groups."""

    names: tuple[str, ...]  # of the groups
    members: tuple[JudgedStage, ...]
    causes: tuple[GroupCause, ...]  # in the order of the model
    joint: JointFit | None  # None if there is no cause


def decided(judged: Mapping[str, JudgedStage]) -> Decided:
    """Return the model of one stage: what some group shows and the others do not exclude.

    Causes that the others make superfluous are dropped, one at a time, the weakest first.

    Parameters
    ----------
    judged : mapping of str to Judged
        By group.
    """
    members = tuple(judged.values())
    causes = causes_of(members)
    joint = None
    while causes:
        joint = fit_in_all(members, [_model(j, causes) for j in members])
        doubt = [_doubt(joint, index, cause) for index, cause in enumerate(causes)]
        weakest = int(np.argmax(doubt))
        if doubt[weakest] < 1.0:
            break
        del causes[weakest]
        joint = None
    return Decided(tuple(judged), members, tuple(causes), joint)


def with_what_remains(whole: Decided, rng: np.random.Generator) -> Decided:
    """Return the groups at the common model; if it differs, unknown structure is mapped again.

    A cause that the logs of one group hardly show may look like unknown structure there.
    """
    if whole.joint is None:
        return whole
    members = []
    for group, j in enumerate(whole.members):
        problem, model = j.prepared.problem, whole.joint.model(group)
        point = problem.point(model, whole.joint.points[group].poses)
        unknown = j.unknown
        if unknown or set(model.causes) != set(j.point.model.causes):
            explained = max(j.prepared.base.deviance - point.deviance, 0.0)
            unknown = remaining(
                problem, point, rng, families_of(problem, point), explained
            )
        members.append(replace(j, point=point, whole=point, unknown=unknown))
    return replace(whole, members=tuple(members))


def with_rival(decided: Decided, index: int, rival: Fitted) -> JointFit:
    """Return the model with a rival in place of a cause; free parameters stay free."""
    assert decided.joint is not None
    models = [
        point.model.swapped(index, rival.candidate, rival.theta)
        for point in decided.joint.points
    ]
    mine = decided.joint.points[0].model.slices[index]
    free = decided.joint.all.free
    own = np.full(rival.candidate.n, bool(free[mine].any()))
    free = np.concatenate([free[: mine.start], own, free[mine.stop :]])
    return fit_in_all(decided.members, models, free)


def _model(j: JudgedStage, causes: Sequence[GroupCause]) -> Model:
    """Return the model of a group, with its own values where it has any."""
    own = {f.candidate.label: f for f in j.point.model.fitted}
    model = Model()
    for cause in causes:
        c = cause.candidate
        model = model.plus(c, own.get(c.label, cause.fitted).theta)
    return model


def _doubt(joint: JointFit, index: int, cause: GroupCause) -> float:
    """Return the doubt in a cause: 1 over its evidence; at 1 or above it is not needed."""
    values = [joint.model(group).fitted[index] for group in range(len(joint.members))]
    if not any(map(worth_a_name, values)):
        return np.inf
    if any(worth_a_name(f) and at_bound(f) for f in values):
        return np.inf
    if any(map(implausible, values)) and all(map(implausible, cause.rivals.values())):
        return np.inf
    mine = joint.points[0].model.slices[index]
    free = joint.all.free[mine]
    null = np.array(values[0].candidate.null)
    evidence, freedom = 0.0, 0
    known = np.stack([fit.known[mine] for fit in joint.fits])
    for group, value in enumerate(values):
        counts = free & known[group]
        if group == 0:  # shared parameters count once
            counts |= ~free & known.any(axis=0)
        if not counts.any():
            continue
        away = (np.array(value.theta) - null)[counts]
        covariance = joint.all.covariance[group][mine, mine][np.ix_(counts, counts)]
        evidence += float(away @ np.linalg.pinv(covariance) @ away)
        freedom += int(counts.sum())
    least = max(float(stats.chi2.isf(SCREEN_LEVEL, max(freedom, 1))), LEAST_GAIN)
    return least / max(evidence, 1e-9)
