"""From fitted models to findings: parameters with intervals, groups, sentences."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Final

import numpy as np

from hilserver.diagnosis.catalogue.traits import POSITION_FIELD, traits_of
from hilserver.diagnosis.catalogue.vocabulary import (
    CAUSES,
    OF_THE_LOG,
    OUTLIERS,
    SPEED_STEP,
    Block,
    cause_of,
    part_of,
)
from hilserver.diagnosis.decide.anchors import Anchor
from hilserver.diagnosis.decide.identifiability import Rival
from hilserver.diagnosis.decide.lost_steps import LostSteps
from hilserver.diagnosis.decide.scrubbing import as_friction
from hilserver.diagnosis.decide.structure import Unknown
from hilserver.diagnosis.decide.trial import implausible
from hilserver.diagnosis.findings.estimate import fitted_covariance, is_wave
from hilserver.diagnosis.findings.explain import explain_finding, number, separating_experiment
from hilserver.diagnosis.noise.quick_noise import aside
from hilserver.diagnosis.regression.intervals import limits
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.evidence import FittedTerm
from hilserver.diagnosis.schema.findings import Finding, Gain, Parameter, Verdict
from hilserver.measured.arrays import Array
from hilserver.measured.channels import POSITION, SETPOINTS
from hilserver.measured.names import signal_unit

COARSE_SHARE: Final = 0.002
"""Half the interval of a step that the spectrum tells, by the step."""


def parameters(problem: Problem, point: Point) -> dict[int, dict[str, Parameter]]:
    """Return the parameters of every accepted cause with their intervals, by its index."""
    shown = limits(point.model.theta(), *fitted_covariance(problem, point))
    parts = zip(point.model.fitted, point.model.slices, strict=True)
    return {i: parameters_of(f, shown[mine]) for i, (f, mine) in enumerate(parts)}


def parameters_of(f: Fitted, shown: Array) -> dict[str, Parameter]:
    """Return the parameters of one cause as they are reported.

    Parameters
    ----------
    shown : ndarray, shape (f.candidate.n, 2)
        Limits of 95 % of the parameters as fitted.
    """
    terms = dict(f.terms)
    if is_wave(f):
        return _wave(f, shown)
    out = {}
    for k, (name, value) in enumerate(terms.items()):
        public = OF_THE_LOG.get(name, name)
        ci = f.candidate.undecided.get(name)
        if k < f.candidate.n:
            low, high = sorted((float(shown[k, 0]), float(shown[k, 1])))
            ci = (low, high)
        out[public] = Parameter(value=value, ci95=ci, unit=unit_of(public))
    return out


def _wave(f: Fitted, shown: Array) -> dict[str, Parameter]:
    names = list(f.terms)
    a, b = f.theta
    size, phase = float(np.hypot(a, b)), float(np.arctan2(b, a))
    half = 0.5 * (shown[:, 1] - shown[:, 0])
    along = float(np.hypot(half[0] * a, half[1] * b) / max(size, 1e-300))
    across = float(np.hypot(half[0] * b, half[1] * a) / max(size, 1e-300) / max(size, 1e-300))
    return {
        names[0]: Parameter(value=size, ci95=(size - along, size + along), unit=unit_of(names[0])),
        names[1]: Parameter(value=phase, ci95=(phase - across, phase + across), unit="rad"),
    }


def unit_of(name: str) -> str:
    """Return the unit of a parameter of the vocabulary."""
    try:
        return part_of(name).unit
    except KeyError:
        return "1"


def named(
    problem: Problem,
    point: Point,
    ties: Mapping[str, Sequence[Rival]],
    p: Mapping[str, float],
    drift: Mapping[str, float],
    *,
    scrubs: bool = False,
    anchor: Anchor | None = None,
) -> list[Finding]:
    """Return one finding for every accepted cause, with its group; what is plausible comes first.

    Parameters
    ----------
    scrubs : bool
        Friction across the wheels is a twin of the rotation gain, see `scrubbing`.
    anchor : Anchor, optional
        That could stand in the place of a scale of the navigation.
    """
    own = parameters(problem, point)
    found = []
    for i, f in enumerate(point.model.fitted):
        cause = f.candidate.cause
        values = dict(own[i])
        causes, behind = [cause], {cause} if implausible(f) else set()
        for rival in ties.get(cause, ()):
            if rival.candidate.cause in causes:
                continue
            causes.append(rival.candidate.cause)
            behind |= {rival.candidate.cause} if implausible(rival.fitted) else set()
            index = rival.point.model.fitted.index(rival.fitted)
            values |= parameters(problem, rival.point)[index]
        twins = _twins(problem, f, own[i].get(cause), scrubs=scrubs, anchor=anchor)
        causes += [cause_of(name).name for name in twins]
        causes.sort(key=behind.__contains__)
        values |= twins
        found.append(
            fitted_finding(causes, values, drift.get(cause, p.get(cause, 0.01)), cause in drift)
        )
    return found


def _twins(
    problem: Problem, f: Fitted, own: Parameter | None, *, scrubs: bool, anchor: Anchor | None
) -> dict[str, Parameter]:
    """Return what these data cannot tell from a cause and no candidate is fitted for."""
    traits = traits_of(f.candidate.cause)
    found: dict[str, Parameter] = {}
    if own is None:
        return found
    if scrubs and traits.scrubs_as:
        ratio = as_friction(problem.stage.robot, f, own)
        if ratio is not None:
            found[traits.scrubs_as] = ratio
    if traits.mirrored_by and not problem.stage.robot.is_mecanum:
        found[traits.mirrored_by] = _mirrored(own)
    if anchor is not None and traits.field:
        found |= _field(anchor)
    return found


def fitted_finding(
    causes: Sequence[str], values: dict[str, Parameter], p: float, drifts: bool
) -> Finding:
    """Return the finding of a fitted cause, the first, and those that could stand in its place."""
    alone = Verdict.DATA_FAULT if CAUSES[causes[0]].block == "data" else Verdict.NAMED
    verdict = alone if len(causes) == 1 else Verdict.NAMED_GROUP
    finding = Finding(
        verdict=Verdict.DRIFT if drifts else verdict,
        causes=tuple(causes),
        block=CAUSES[causes[0]].block,
        parameters=values,
        p_adjusted=p,
        separating_experiment=separating_experiment(causes) if len(causes) > 1 else None,
    )
    return finding.model_copy(update={"explanation": explain_finding(finding)})


def _mirrored(own: Parameter) -> Parameter:
    """Return the size of a cause that does the same with the other sign."""
    low, high = own.ci95 or (own.value, own.value)
    return Parameter(value=-own.value, ci95=(-high, -low), unit=own.unit)


def deviating(problem: Problem, point: Point) -> dict[str, Parameter]:
    """Return the channel that a model misses most, by the channel's own noise, and by how much."""
    missed = {name: float(np.mean(point.left[e] ** 2)) for name, e in problem.stack.edges.items()
              if e.stop > e.start}  # fmt: skip
    name = max(missed, key=lambda channel: missed[channel])
    residual = problem.residual(point.predicted)[problem.stack.edges[name]]
    mean = float(np.mean(np.abs(residual)))
    return {name: Parameter(value=mean, ci95=None, unit=signal_unit(name))}


def structure(unknown: Sequence[Unknown], block: Block, most: dict[str, Parameter]) -> Finding:
    """Return the finding of unknown structure: what the error depends on, strongest first.

    Parameters
    ----------
    block : str
        Where it arises.
    most : dict of str to Parameter
        The signal that deviates most, see `deviating`.
    """
    names: list[str] = []
    for u in unknown:
        names += [r for r in u.family.regressors if r not in names]
    finding = Finding(
        verdict=Verdict.STRUCTURE_NOT_IN_LIBRARY,
        causes=(),
        block=block,
        p_adjusted=unknown[0].p,
        regressors=tuple(names[:6]),
        parameters=most,
    )
    return finding.model_copy(update={"explanation": explain_finding(finding)})


def lost(steps: LostSteps) -> Finding:
    """Return the finding of set-points that were logged as sent and never arrived."""
    text = (
        f"{steps.events} of {steps.judged} set-point steps stand in the log as sent, but reached"
        " the wheels a message too late or never: messages were lost on the way."
    )
    return Finding(
        verdict=Verdict.STRUCTURE_NOT_IN_LIBRARY,
        causes=(),
        block="drive",
        p_adjusted=0.001,
        regressors=(*SETPOINTS, "input.sequence"),
        explanation=text,
    )


def coarse(step_rpm: float) -> Finding:
    """Return the finding of wheel speeds that come in steps."""
    half = COARSE_SHARE * step_rpm
    finding = Finding(
        verdict=Verdict.NAMED,
        causes=(SPEED_STEP,),
        block=CAUSES[SPEED_STEP].block,
        parameters={
            SPEED_STEP: Parameter(
                value=step_rpm, ci95=(step_rpm - half, step_rpm + half), unit="rpm"
            )
        },
        p_adjusted=0.001,
    )
    return finding.model_copy(update={"explanation": explain_finding(finding)})


def misplaced_anchor(anchor: Anchor, p: float) -> Finding:
    """Return the finding of a ranging anchor that stands elsewhere than configured."""
    error_m, side = anchor.error_m, "long" if anchor.error_m > 0.0 else "short"
    finding = Finding(
        verdict=Verdict.NAMED,
        causes=(cause_of(POSITION_FIELD).name,),
        block=cause_of(POSITION_FIELD).block,
        parameters=_field(anchor),
        p_adjusted=p,
    )
    text = (
        f"{explain_finding(finding).rstrip('.')}, as if the ranging anchor on the side of"
        f" {anchor.side} measured about {number(abs(error_m), 'm', digits=2)} too {side}."
    )
    return finding.model_copy(update={"explanation": text})


def _field(anchor: Anchor) -> dict[str, Parameter]:
    """Return how far the position is off where an anchor moves it most."""
    size_m, half_m = anchor.largest * abs(anchor.error_m), anchor.largest * anchor.half_m
    limits = (size_m - half_m, size_m + half_m)
    return {POSITION_FIELD: Parameter(value=size_m, ci95=limits, unit="m")}


def outliers(problem: Problem, point: Point, least_share: float = 0.004) -> Finding | None:
    """Return the finding of outliers in the position, if there are more than noise explains.

    An outlier stands out from its neighbours: where all of them are off, the model is.
    """
    stack = problem.stack
    if not all(n in stack.edges for n in POSITION):
        return None
    x, y = (stack.edges[n] for n in POSITION)
    if x.stop - x.start != y.stop - y.start:
        return None
    away = problem.residual(point.predicted)
    for _, _, part in stack.runs():
        away[part] = aside(stack.t_s[part], away[part])
    size = np.hypot(away[x], away[y])
    noise = max(
        float(np.hypot(problem.noise[n].white_sd, problem.noise[n].ou_sd)) for n in POSITION
    )
    left_out = ((problem.weights[x] == 0.0) | (problem.weights[y] == 0.0)) & (
        size > max(0.3, 5.0 * noise)
    )
    n, k = len(left_out), int(left_out.sum())
    if n == 0 or k < 6 or k / n < least_share:
        return None
    share = k / n
    half = 1.96 * np.sqrt(share * (1.0 - share) / n)
    sizes = size[left_out]
    half_size = 2.0 * 1.2533 * sizes.std(ddof=1) / np.sqrt(k) + 0.01 * float(np.median(sizes))
    middle = float(np.median(sizes))
    finding = Finding(
        verdict=Verdict.NAMED,
        causes=(cause_of(OUTLIERS[0]).name,),
        block=cause_of(OUTLIERS[0]).block,
        parameters={
            name: Parameter(value=value, ci95=(value - width, value + width), unit=unit_of(name))
            for name, value, width in zip(OUTLIERS, (share, middle), (half, half_size), strict=True)
        },
        p_adjusted=0.001,
    )
    return finding.model_copy(update={"explanation": explain_finding(finding)})


def extension(findings: Iterable[Finding], fitted: Mapping[int, Fitted]) -> tuple[FittedTerm, ...]:
    """Return the plant terms that the findings switch on."""
    out = []
    for index, finding in enumerate(findings):
        if index in fitted:
            names = tuple(fitted[index].terms)
        elif finding.causes == (SPEED_STEP,):
            names = finding.causes  # known from the values alone
        else:
            continue
        for name in names:
            if name in OF_THE_LOG or name not in finding.parameters:
                continue
            p = finding.parameters[name]
            out.append(FittedTerm(name, p.value, p.ci95, p.unit, index, p.groups))
    return tuple(out)


def worsened(*gains: Mapping[str, Gain]) -> str | None:
    """Return why no extension is written: the whole interval of a quantity is a loss; or None."""
    for key, gain in (item for some in gains for item in some.items()):
        if gain.ci95 is not None and gain.ci95[1] < 1.0:
            low, high = gain.ci95
            return (
                f"no model patch: its terms make {key} worse on data that took no part in the fit"
                f" (ratio {gain.ratio:.2f}, {low:.2f} to {high:.2f})"
            )
    return None
