"""From fitted models to findings: parameters with intervals, groups, sentences."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.traits import POSITION_FIELD
from hilserver.diagnosis.catalogue.vocabulary import (
    CAUSES,
    OF_THE_LOG,
    OUTLIERS,
    SPEED_STEP,
    Block,
    cause_of,
    unit_of,
)
from hilserver.diagnosis.decide.anchors import Anchor
from hilserver.diagnosis.decide.lost_steps import lost_steps
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.decide.structure import Unknown
from hilserver.diagnosis.findings.estimate import is_wave
from hilserver.diagnosis.findings.explain import (
    explain,
    explain_finding,
    number,
    separating_experiment,
)
from hilserver.diagnosis.noise.quick_noise import deviation_from_median
from hilserver.diagnosis.regression.intervals import limits, whole_covariance
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.evidence import FittedTerm
from hilserver.diagnosis.schema.findings import Finding, Gain, Parameter, Verdict
from hilserver.diagnosis.thresholds import (
    COMB_EXACT,
    FEWEST_EVENTS,
    LEAST_OUTLIERS,
    NEGLIGIBLE,
)
from hilserver.measured.channels import POSITION, SETPOINTS
from hilserver.measured.names import signal_unit


def parameters(problem: Problem, point: Point) -> dict[int, dict[str, Parameter]]:
    """Return the parameters of every accepted cause with their intervals, by its index."""
    shown = limits(point.model.theta(), *whole_covariance(problem, point))
    parts = zip(point.model.fitted, point.model.slices, strict=True)
    return {i: parameters_of(f, shown[mine]) for i, (f, mine) in enumerate(parts)}


def parameters_of(f: Fitted, shown: Array) -> dict[str, Parameter]:
    """Return the parameters of one cause as they are reported.

    Parameters
    ----------
    shown : ndarray, shape (f.candidate.n, 2)
        95 % limits of the parameters as fitted.
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
    across = float(
        np.hypot(half[0] * b, half[1] * a) / max(size, 1e-300) / max(size, 1e-300)
    )
    return {
        names[0]: _within(size, along, unit_of(names[0])),
        names[1]: _within(phase, across, "rad"),
    }


def chance(j: JudgedStage, cause: str) -> float:
    """Return the p of an accepted cause; 1 % for one that replaced another."""
    return j.drift.get(cause, j.selected.p.get(cause, 0.01))


def other_findings(j: JudgedStage) -> list[Finding]:
    """Return what was found in one stage besides fitted causes."""
    problem, found = j.prepared.problem, []
    if j.prepared.coarse_rpm is not None:
        found.append(coarse(j.prepared.coarse_rpm))
    if (far := outliers(problem, j.point)) is not None:
        found.append(far)
    if j.anchor is not None:
        found.append(misplaced_anchor(*j.anchor))
    late, judged = lost_steps(problem, j.point)
    if late >= FEWEST_EVENTS:
        found.append(lost(late, judged))
    # three events of all wheels: fewer explain no structure
    if j.unknown and late < max(FEWEST_EVENTS * len(SETPOINTS), NEGLIGIBLE * judged):
        found.append(
            structure(j.unknown, problem.stage.block, deviating(problem, j.point))
        )
    return found


def fitted_finding(
    causes: Sequence[str],
    values: dict[str, Parameter],
    p: float,
    drifts: bool,
    acting: int = 1,
) -> Finding:
    """Return the finding of a fitted cause, listed first, and of those that could replace it.

    Parameters
    ----------
    acting : int
        How many of the causes act.
    """
    block, one = CAUSES[causes[0]].block, len(causes) == 1
    alone = Verdict.DATA_FAULT if block == "data" else Verdict.NAMED
    verdict = Verdict.DRIFT if drifts else alone if one else Verdict.NAMED_GROUP
    experiment = None if one else separating_experiment(causes)
    finding = _finding(
        verdict, causes, block, p, parameters=values, separating_experiment=experiment
    )
    if acting == 1 or drifts:
        return finding
    text = explain(finding.causes, finding.parameters, acting)
    return finding.model_copy(update={"explanation": text})


def effective(cause: str, values: dict[str, Parameter], p: float) -> Finding:
    """Return the finding of an item that acts like a cause."""
    return _finding(
        Verdict.EFFECTIVE, (cause,), CAUSES[cause].block, p, parameters=values
    )


def _finding(
    verdict: Verdict, causes: Iterable[str], block: Block, p: float, **fields: Any
) -> Finding:
    """Return a finding with its sentence."""
    finding = Finding(
        verdict=verdict, causes=tuple(causes), block=block, p_adjusted=p, **fields
    )
    return finding.model_copy(update={"explanation": explain_finding(finding)})


def _named(name: str, parameters: dict[str, Parameter], p: float = 0.001) -> Finding:
    """Return the finding of a cause that needs no fit of the plant, with its sentence."""
    cause = cause_of(name)
    return _finding(Verdict.NAMED, (cause.name,), cause.block, p, parameters=parameters)


def _within(value: float, half: float, unit: str) -> Parameter:
    return Parameter(value=value, ci95=(value - half, value + half), unit=unit)


def deviating(problem: Problem, point: Point) -> dict[str, Parameter]:
    """Return the channel that a model misses most, relative to its own noise, and by how much."""
    missed = {name: float(np.mean(point.left[e] ** 2)) for name, e in problem.stack.edges.items()
              if e.stop > e.start}  # fmt: skip
    name = max(missed, key=lambda channel: missed[channel])
    residual = problem.residual(point.predicted)[problem.stack.edges[name]]
    mean = float(np.mean(np.abs(residual)))
    return {name: Parameter(value=mean, ci95=None, unit=signal_unit(name))}


def structure(
    unknown: Sequence[Unknown], block: Block, most: dict[str, Parameter]
) -> Finding:
    """Return the finding of unknown structure: what the error depends on, the strongest first.

    Parameters
    ----------
    block : str
        Where it arises.
    most : dict of str to Parameter
        The signal that deviates most, see `deviating`.
    """
    names = dict.fromkeys(r for u in unknown for r in u.family.regressors)
    return _finding(
        Verdict.STRUCTURE_NOT_IN_LIBRARY, (), block, unknown[0].p,
        regressors=tuple(names)[:6], parameters=most,
    )  # fmt: skip


def lost(late: int, judged: int) -> Finding:
    """Return the finding of set-points that were logged as sent but never arrived."""
    text = (
        f"{late} of {judged} set-point steps were logged as sent but reached the wheels one"
        " message late or never: messages were lost on the way."
    )
    return _finding(
        Verdict.STRUCTURE_NOT_IN_LIBRARY, (), "drive", 0.001,
        regressors=(*SETPOINTS, "input.sequence"), explanation=text,
    )  # fmt: skip


def coarse(step_rpm: float) -> Finding:
    """Return the finding of wheel speeds that come in steps."""
    return _named(
        SPEED_STEP, {SPEED_STEP: _within(step_rpm, COMB_EXACT * step_rpm, "rpm")}
    )


def misplaced_anchor(anchor: Anchor, p: float) -> Finding:
    """Return the finding of a ranging anchor that is not where it is configured."""
    error_m, side = anchor.error_m, "long" if anchor.error_m > 0.0 else "short"
    finding = _named(POSITION_FIELD, field_of(anchor), p)
    text = (
        f"{finding.explanation.rstrip('.')}, as if the ranging anchor on the side of"
        f" {anchor.side} measured about {number(abs(error_m), 'm', digits=2)} too {side}."
    )
    return finding.model_copy(update={"explanation": text})


def field_of(anchor: Anchor) -> dict[str, Parameter]:
    """Return how far the position is off at the place where an anchor moves it most."""
    size_m, half_m = (
        anchor.largest * abs(anchor.error_m),
        anchor.largest * anchor.half_m,
    )
    return {POSITION_FIELD: _within(size_m, half_m, "m")}


def outliers(problem: Problem, point: Point) -> Finding | None:
    """Return the finding of outliers in the position, if there are more than noise explains.

    An outlier is far from its neighbours: if all of them are off, it is the model that is wrong.
    """
    stack = problem.stack
    if not all(n in stack.edges for n in POSITION):
        return None
    x, y = (stack.edges[n] for n in POSITION)
    if x.stop - x.start != y.stop - y.start:
        return None
    away = problem.residual(point.predicted)
    for _, _, part in stack.runs():
        away[part] = deviation_from_median(stack.t_s[part], away[part])
    size = np.hypot(away[x], away[y])
    noise = max(
        float(np.hypot(problem.noise[n].white_sd, problem.noise[n].ou_sd))
        for n in POSITION
    )
    left_out = (problem.weights[x] == 0.0) | (problem.weights[y] == 0.0)
    sizes = size[left_out & (size > max(0.3, 5.0 * noise))]
    n, k = len(size), len(sizes)
    if k < 6 or k / n < LEAST_OUTLIERS:
        return None
    share, middle = k / n, float(np.median(sizes))
    half = 1.96 * np.sqrt(share * (1.0 - share) / n)
    half_size = 2.0 * 1.2533 * sizes.std(ddof=1) / np.sqrt(k) + 0.01 * middle
    found = zip(OUTLIERS, (share, middle), (half, half_size), strict=True)
    values = {
        name: _within(value, width, unit_of(name)) for name, value, width in found
    }
    return _named(OUTLIERS[0], values)


def extension(
    findings: Iterable[Finding], fitted: Mapping[int, Fitted]
) -> tuple[FittedTerm, ...]:
    """Return the plant terms that the findings switch on."""
    out: list[FittedTerm] = []
    for index, finding in enumerate(findings):
        names: Iterable[str] = fitted[index].terms if index in fitted else ()
        if finding.causes == (SPEED_STEP,):  # known from the values alone
            names = finding.causes
        own = (n for n in names if n in finding.parameters and n not in OF_THE_LOG)
        out += [FittedTerm(name, finding.parameters[name]) for name in own]
    return tuple(out)


def worsened(*patches: Mapping[str, Gain]) -> str | None:
    """Return why no extension is written, or None.

    It is not if the whole interval of a quantity that the patch changes is a loss, wherever its
    gain was measured.
    """
    changed = {
        key for gains in patches for key, gain in gains.items() if gain.ratio != 1.0
    }
    for key, gain in (item for some in patches for item in some.items()):
        if key in changed and gain.ci95 is not None and gain.ci95[1] < 1.0:
            low, high = gain.ci95
            return (
                f"no model patch: its terms make {key} worse on data not used for the fit"
                f" (ratio {gain.ratio:.2f}, {low:.2f} to {high:.2f})"
            )
    return None
