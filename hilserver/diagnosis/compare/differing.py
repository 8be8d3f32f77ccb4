"""From differences to findings: the cause that explains one best, and its twins."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy import stats

from hilserver.diagnosis.catalogue.vocabulary import CAUSES, OF_THE_LOG, unit_of
from hilserver.diagnosis.compare.differences import Difference
from hilserver.diagnosis.decide.identifiability import rivals
from hilserver.diagnosis.findings.explain import separating_experiment
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.linear import cosine
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.schema.findings import Detectable, Finding, Parameter, Verdict
from hilserver.diagnosis.thresholds import (
    COMPARE_LEVEL,
    DETECTABLE_POWER_SD,
    GROUP_COSINE,
    TIE,
)


def difference_findings(
    differences: Sequence[Difference],
    prepared: Mapping[str, Prepared],
    points: Mapping[str, Point],
) -> list[Finding]:
    """Name the cause that best explains the difference in each stage, and its twins.

    Parameters
    ----------
    points : mapping of str to Point
        By stage, the model that explains both sets together.
    """
    found = []
    for stage, p in prepared.items():
        mine = sorted(
            (d for d in differences
             if d.stage == stage and d.p < COMPARE_LEVEL and d.is_worth_a_name and d.is_possible),
            key=lambda d: -d.gain,
        )  # fmt: skip
        if not mine:
            continue
        best = mine[0]
        if best.gain < 10.0:
            continue
        group = [best]
        for d in mine[1:]:
            if d.candidate.cause in {g.candidate.cause for g in group}:
                continue
            if best.gain - d.gain < TIE and _cosine(p.library, best, d) > GROUP_COSINE:
                group.append(d)
        group += _imitators(
            p.library, points[stage], best, {d.candidate.cause for d in group}
        )
        found.append(_finding(group))
    return found


def _imitators(
    library: Library, point: Point, best: Difference, named: Collection[str]
) -> list[Difference]:
    """Return twins of a cause that both sets share: added to it, they have nothing to explain."""
    index = next(
        (
            k
            for k, f in enumerate(point.model.fitted)
            if f.candidate.cause == best.candidate.cause
        ),
        None,
    )
    if index is None or best.candidate.n > 1:
        return []
    accepted = point.model.fitted[index]
    away = accepted.theta[0] - accepted.candidate.null[0]
    out = []
    for rival in rivals(library, point, index):
        c = rival.candidate
        # what remains is the difference itself
        alike = rival.close and rival.cosine > GROUP_COSINE
        if not alike or c.n > 1 or c.cause in named:
            continue
        share = (rival.fitted.theta[0] - c.null[0]) / away
        values = (best.values[0] * share, best.values[1] * share)
        errors = (best.errors[0] * abs(share), best.errors[1] * abs(share))
        out.append(replace(best, candidate=c, values=values, errors=errors))
    return out


def _cosine(library: Library, a: Difference, b: Difference) -> float:
    x, y = (library.columns[:, d.column].astype(np.float64) for d in (a, b))
    return cosine(x, y)


def _finding(group: Sequence[Difference]) -> Finding:
    parameters: dict[str, Parameter] = {}
    words = []
    for d in group:
        name = next(iter(d.candidate.terms(d.candidate.start)))
        name = OF_THE_LOG.get(name, name)
        unit, wide = unit_of(name), float(stats.t.ppf(0.975, max(d.dof, 1.0)))
        for key, value, error in zip("ab", d.values, d.errors, strict=True):
            limits = (value - wide * error, value + wide * error)
            parameters[f"{name}.{key}"] = Parameter(value=value, ci95=limits, unit=unit)
        change = d.values[1] - d.values[0]
        half = wide * float(np.hypot(*d.errors))
        parameters[name] = Parameter(
            value=change, ci95=(change - half, change + half), unit=unit
        )
        text = "" if unit == "1" else f" {unit}"
        words.append(
            f"{name}: {d.values[0]:.3g}{text} before, {d.values[1]:.3g}{text} after"
        )
    causes = tuple(d.candidate.cause for d in group)
    return Finding(
        verdict=Verdict.DIFFERS,
        causes=causes,
        block=CAUSES[causes[0]].block,
        parameters=parameters,
        p_adjusted=group[0].p,
        explanation=f"The two sets differ: {'; or '.join(words)}.",
        separating_experiment=separating_experiment(causes)
        if len(causes) > 1
        else None,
    )


def smallest_differences(
    differences: Sequence[Difference], count: int
) -> tuple[Detectable, ...]:
    """Return, by cause, the smallest difference that would have been found among `count` judged."""
    sizes: dict[str, Detectable] = {}
    for d in differences:
        least = float(stats.t.ppf(1.0 - 0.5 * COMPARE_LEVEL / count, max(d.dof, 1.0)))
        aim = least + DETECTABLE_POWER_SD
        size = max(aim * float(np.hypot(*d.errors)), d.candidate.least)
        cause = d.candidate.cause
        if cause not in sizes or size < sizes[cause].size:
            name = next(iter(d.candidate.terms(d.candidate.start)))
            sizes[cause] = Detectable(cause=cause, size=size, unit=unit_of(name))
    return tuple(sizes.values())
