"""Which causes may be behind each item of a model: the item, rivals that tie, twins of both.

Items with a common rival are one group: it may stand for either of them, and then the other has
another size. A radius, a turn gain and a scale of the navigation change two things, the way and
the turn: which two of the three act, and how large they are, no log tells.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

from hilserver.diagnosis.catalogue.traits import traits_of
from hilserver.diagnosis.catalogue.vocabulary import cause_of
from hilserver.diagnosis.decide.predicting import halfway
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.decide.scrubbing import as_friction
from hilserver.diagnosis.decide.trial import implausible
from hilserver.diagnosis.findings.outcome import (
    chance,
    effective,
    field_of,
    fitted_finding,
    parameters,
)
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.schema.findings import Finding, Parameter

Values = dict[str, Parameter]


class InItsPlace(NamedTuple):
    """A rival that ties with an item, in the model that it is part of."""

    cause: str
    model: Model
    parameters: Mapping[int, Values]  # by cause, in the order of the model


def named_findings(j: JudgedStage) -> tuple[Finding, ...]:
    """Return one finding for every item of a patch, in its group; plausible ones come first."""
    problem, model = j.prepared.problem, j.point.model
    if not model.fitted:
        return ()
    own = parameters(problem, j.point)

    rivals: dict[str, list[InItsPlace]] = {cause: [] for cause in model.causes}
    for cause, found in rivals.items():
        for rival in () if cause in j.effective else j.ties.get(cause, ()):
            point = halfway(problem, rival.point)
            shown = parameters(problem, point)
            found.append(InItsPlace(rival.candidate.cause, point.model, shown))

    findings = []
    for index, cause in enumerate(model.causes):
        p, drifts = chance(j, cause), cause in j.drift
        if cause in j.effective:
            findings.append(effective(cause, own[index], p))
            continue
        items = [cause] if drifts else connected(cause, rivals, j.drift)
        causes, values = _behind(j, items, own, rivals)
        findings.append(fitted_finding(causes, values, p, drifts, len(items)))
    return tuple(findings)


def connected(
    cause: str,
    rivals: Mapping[str, Sequence[InItsPlace]],
    drifting: Mapping[str, float],
) -> list[str]:
    """Return an item, and those that share a rival with it or with another one of them."""
    items = [cause]
    known = {one.cause for one in rivals[cause]}
    for _ in rivals:
        for other, others in rivals.items():
            theirs = {one.cause for one in others}
            if other not in items and other not in drifting and known & theirs:
                items.append(other)
                known |= theirs
    return items


def _behind(
    j: JudgedStage,
    items: Sequence[str],
    own: Mapping[int, Values],
    rivals: Mapping[str, Sequence[InItsPlace]],
) -> tuple[list[str], Values]:
    """Return the causes that may be behind some items, and their parameters."""
    model = j.point.model
    fitted: dict[str, Fitted] = {}
    values: Values = {}
    for item in items:
        index = model.causes.index(item)
        fitted[item] = model.fitted[index]
        values |= own[index]
    models = [one for item in items for one in rivals[item]]
    for one in models:
        in_place = one.model.fitted[one.model.causes.index(one.cause)]
        fitted.setdefault(one.cause, in_place)

    # the interval of a parameter spans all models that are possible
    for one in models:
        for index, cause in enumerate(one.model.causes):
            for name, other in one.parameters[index].items() if cause in fitted else ():
                known = values.setdefault(name, other)
                if known.ci95 is not None and other.ci95 is not None:
                    ends = (*known.ci95, *other.ci95)
                    spanned = {"ci95": (min(ends), max(ends))}
                    values[name] = known.model_copy(update=spanned)

    causes = list(fitted)
    unlikely = {cause for cause, f in fitted.items() if implausible(f)}
    for cause, f in fitted.items():
        twins = _twins(j, f, values.get(cause))
        values |= twins
        names = dict.fromkeys(cause_of(part).name for part in twins)
        causes += [name for name in names if name not in causes]
    return sorted(causes, key=unlikely.__contains__), values


def _twins(j: JudgedStage, f: Fitted, own: Parameter | None) -> Values:
    """Return twins of a cause that the data cannot exclude and that have no candidate."""
    traits, robot = traits_of(f.candidate.cause), j.prepared.problem.stage.robot
    found: Values = {}
    if own is None:
        return found
    if j.scrubs and traits.scrubs_as:
        ratio = as_friction(robot, f, own)
        if ratio is not None:
            found[traits.scrubs_as] = ratio
    if traits.mirrored_by and not robot.is_mecanum:
        low, high = own.ci95 or (own.value, own.value)
        mirrored = Parameter(value=-own.value, ci95=(-high, -low), unit=own.unit)
        found[traits.mirrored_by] = mirrored
    if j.in_doubt is not None and traits.field:
        found |= field_of(j.in_doubt)
    return found
