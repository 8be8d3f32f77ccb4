"""From a joint model to findings: shared values, and values by group."""

from collections.abc import Sequence

import numpy as np

from hilserver.diagnosis.decide.trial import at_bound
from hilserver.diagnosis.findings.estimate import (
    StageEstimate,
    is_wave,
    priors,
    reported,
    with_priors,
)
from hilserver.diagnosis.findings.explain import explain
from hilserver.diagnosis.findings.outcome import fitted_finding, parameters_of
from hilserver.diagnosis.groups.deciding import Decided, with_rival
from hilserver.diagnosis.groups.joint_fit import JointFit
from hilserver.diagnosis.regression.intervals import limits
from hilserver.diagnosis.schema.findings import Finding, InGroup, Parameter


def fitted_findings(decided: Decided) -> tuple[Finding, ...]:
    """Return one finding for every cause of a stage, in the order of the model."""
    joint = decided.joint
    if joint is None:
        return ()
    names, found = decided.names, []
    for index, cause in enumerate(decided.causes):
        values, causes = parameters_by_group(joint, index, names), [cause.name]
        for rival_name, rival in cause.rivals.items():
            other = with_rival(decided, index, rival)
            if any(at_bound(other.model(g).fitted[index]) for g in range(len(names))):
                continue
            causes.append(rival_name)
            values |= parameters_by_group(other, index, names)
        finding = fitted_finding(causes, values, cause.p, cause.drifts)
        found.append(finding.model_copy(update={"explanation": in_words(finding)}))
    return tuple(found)


def parameters_by_group(
    joint: JointFit, index: int, names: Sequence[str]
) -> dict[str, Parameter]:
    """Return the parameters of one cause; those that differ have a value per group."""
    mine = joint.points[0].model.slices[index]
    free = joint.all.free[mine]
    shown = []
    for group, fit in enumerate(joint.fits):
        f = joint.model(group).fitted[index]
        own = np.diag(joint.all.covariance[group])[mine]
        dof = np.where(free, fit.dof[mine], sum(one.dof[mine] for one in joint.fits))
        interval = limits(np.asarray(f.theta), np.diag(own), dof)
        parameters = parameters_of(f, interval)
        if free.any() and not fit.known[mine].all():
            parameters = {
                name: p.model_copy(update={"ci95": None})
                for name, p in parameters.items()
            }
        shown.append(parameters)
    whole = is_wave(joint.points[0].model.fitted[index])
    out = {}
    for k, (name, first) in enumerate(shown[0].items()):
        differs = bool(free.any()) if whole else k < len(free) and bool(free[k])
        if not differs:
            out[name] = first
            continue
        groups = {
            group: InGroup(value=own[name].value, ci95=own[name].ci95)
            for group, own in zip(names, shown, strict=True)
        }
        mean = float(np.mean([one.value for one in groups.values()]))
        out[name] = Parameter(value=mean, ci95=None, unit=first.unit, groups=groups)
    return out


def in_words(finding: Finding) -> str:
    """Return the explanation of a finding; values that differ are given for every group."""
    groups = next((p.groups for p in finding.parameters.values() if p.groups), None)
    if groups is None:
        return finding.explanation
    said = []
    for group in groups:
        values = {
            name: p
            if p.groups is None
            else p.model_copy(update={"value": p.groups[group].value})
            for name, p in finding.parameters.items()
        }
        text = explain(finding.causes, values)
        said.append(f"In group {group}: {text[:1].lower()}{text[1:]}")
    return f"Differs by group. {' '.join(said)}"


def estimate_in_groups(joint: JointFit, names: Sequence[str]) -> StageEstimate:
    """Return all parameters of a stage with one covariance, those that differ as ``name@group``."""
    free, whole = joint.all.free, joint.all.unknowns
    size = len(whole)
    turn, prior, value = np.eye(size), np.full(size, np.inf), np.zeros(size)
    labels, owner = [""] * size, np.zeros(size, dtype=np.int64)
    for group, place in enumerate(joint.all.places):
        model = joint.model(group)
        own = StageEstimate.of(model, joint.all.covariance[group])
        turn[np.ix_(place, place)] = reported(model)
        prior[place], value[place], owner[place] = priors(model), own.value, own.owner
        for k, at in enumerate(place.tolist()):
            labels[at] = f"{own.names[k]}@{names[group]}" if free[k] else own.names[k]
    known = np.flatnonzero(np.diag(whole) > 0.0)
    covariance = (turn @ with_priors(whole, prior) @ turn.T)[np.ix_(known, known)]
    return StageEstimate(
        tuple(labels[i] for i in known),
        tuple(owner[known].tolist()),
        value[known],
        covariance,
    )
