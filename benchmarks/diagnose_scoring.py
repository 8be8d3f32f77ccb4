"""A diagnosis compared with the truth: what was right, wrong or missed."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any, Final

import numpy as np
from hilserver_injector.cases import Answer, Case
from scipy import stats

from hilserver.diagnosis.schema.findings import Finding, Findings, Joint, Verdict
from hilserver.plant.terms import TERMS, main_part

LARGEST_GROUP: Final = 5
"""A group that lists everything is a wrong answer."""
WITHIN: Final = 0.2
SHARE: Final = 0.9
"""Probability of the joint ellipsoid."""
_NAMES: Final = frozenset(
    {
        Verdict.NAMED,
        Verdict.NAMED_GROUP,
        Verdict.DRIFT,
        Verdict.DATA_FAULT,
        Verdict.DIFFERS,
    }
)
_SILENT: Final = frozenset({Verdict.INSUFFICIENT_EXCITATION, Verdict.NO_DIFFERENCE})


@dataclass
class Value:
    """A fitted value and the true one."""

    true: float
    fitted: float
    in_ci95: bool | None
    within_20: bool


@dataclass
class Ellipsoid:
    """The ellipsoid of all hidden parameters in `joint`.

    Attributes
    ----------
    inside : bool
        Whether it holds the truth.
    width : float
        Its mean half axis relative to the sizes of the effects: for one parameter the half width of
        the interval, for several the geometric mean.
    """

    inside: bool
    width: float


@dataclass
class Score:
    """Score of one case.

    Attributes
    ----------
    outcome : str
        right, missed, vague (too large a group, or another verdict for the right cause),
        unknown (a structure outside the library instead of the name) or, where nothing is hidden,
        false_alarm.
    wrong : list of str
        Names given with confidence by a finding that does not contain the truth.
    found : list of str
        All findings, as ``verdict:cause|cause``.
    """

    outcome: str
    wrong: list[str] = field(default_factory=list)
    found: list[str] = field(default_factory=list)
    values: dict[str, Value] = field(default_factory=dict)
    ellipsoid: Ellipsoid | None = None

    def as_json(self) -> dict[str, Any]:
        """Return plain data."""
        return asdict(self)


def bare(name: str) -> str:
    """Return the cause of ``cause.part`` or ``cause.channel``."""
    return name.partition(".")[0]


def names(finding: Finding) -> frozenset[str]:
    """Return the causes of a finding without their parts."""
    return frozenset(bare(cause) for cause in finding.causes)


def loud(findings: Findings) -> list[Finding]:
    """Return the findings that claim anything."""
    return [finding for finding in findings.findings if finding.verdict not in _SILENT]


def score(case: Case, findings: Findings) -> Score:
    """Compare the findings on a case's log with its answer."""
    answer, said = case.answer, loud(findings)
    result = Score(
        outcome="missed",
        wrong=["|".join(sorted(names(f))) for f in said if _is_wrong(f, answer)],
        found=[
            f"{finding.verdict}:{'|'.join(sorted(names(finding)))}" for finding in said
        ],
    )
    if answer.verdict == "nothing_found":
        result.outcome = "false_alarm" if said else "right"
    elif answer.verdict == Verdict.STRUCTURE_NOT_IN_LIBRARY:
        result.outcome = _outside(said, answer, result.wrong)
    else:
        result.outcome = _worst(
            [_one(said, wanted, answer) for wanted in answer.causes]
        )
        result.values = _values(said, answer)
        if findings.joint is not None and len(result.values) == len(answer.values):
            result.ellipsoid = ellipsoid_of(findings.joint, answer.values)
    return result


def _is_wrong(finding: Finding, answer: Answer) -> bool:
    """Return whether a finding confidently names something that is not there."""
    if finding.verdict not in _NAMES:
        return False
    truth = frozenset().union(*answer.causes) if answer.causes else frozenset()
    return not names(finding) & truth


def _one(loud: Sequence[Finding], wanted: frozenset[str], answer: Answer) -> str:
    """Return the outcome for one hidden effect."""
    holding = [f for f in loud if f.verdict in _NAMES and names(f) & wanted]
    if not holding:
        unknown = any(f.verdict == Verdict.STRUCTURE_NOT_IN_LIBRARY for f in loud)
        return "unknown" if unknown else "missed"
    for finding in holding:
        if len(finding.causes) > LARGEST_GROUP:
            continue
        if (
            answer.verdict == Verdict.NAMED_GROUP
            and len(names(finding) & answer.together) < 2
        ):
            continue  # one of two twins alone is a coin toss
        if answer.verdict in {Verdict.DRIFT, Verdict.DATA_FAULT} and (
            finding.verdict != answer.verdict
        ):
            continue
        return "right"
    return "vague"


def _worst(outcomes: Sequence[str]) -> str:
    for outcome in ("missed", "unknown", "vague"):
        if outcome in outcomes:
            return outcome
    return "right"


def _outside(loud: Sequence[Finding], answer: Answer, wrong: Sequence[str]) -> str:
    flagged = [f for f in loud if f.verdict == Verdict.STRUCTURE_NOT_IN_LIBRARY]
    if not flagged:
        return "missed"
    first = {finding.regressors[0] for finding in flagged if finding.regressors}
    return "right" if first & answer.regressors and not wrong else "vague"


def _values(loud: Sequence[Finding], answer: Answer) -> dict[str, Value]:
    """Return every scored parameter that was fitted under its true name."""
    fitted: dict[str, Any] = {}
    for finding in loud:
        if finding.verdict in {Verdict.NAMED, Verdict.NAMED_GROUP}:
            fitted |= {_full(name): value for name, value in finding.parameters.items()}
    scored = {}
    for name, true in answer.values.items():
        parameter = fitted.get(_full(name))
        if parameter is None or not math.isfinite(parameter.value):
            continue
        scored[name] = value_of(name, true, parameter.value, parameter.ci95)
    return scored


def value_of(
    name: str, true: float, fitted: float, ci95: tuple[float, float] | None
) -> Value:
    """Return a fitted value and the true one; nearness is relative to the size of the effect."""
    null = TERMS[_full(name)].null or 0.0
    return Value(
        true=true,
        fitted=fitted,
        in_ci95=None if ci95 is None else ci95[0] <= true <= ci95[1],
        within_20=abs(fitted - true) <= WITHIN * abs(true - null),
    )


def ellipsoid_of(joint: Joint, truth: Mapping[str, float]) -> Ellipsoid | None:
    """Return the 90 % ellipsoid of the true parameters; None unless it has all of them."""
    names = [_full(name) for name in joint.parameters]
    if not truth or any(_full(name) not in names for name in truth):
        return None
    own = [names.index(_full(name)) for name in truth]
    true = np.array(list(truth.values()))
    null = np.array([TERMS[_full(name)].null or 0.0 for name in truth])
    covariance = np.array(joint.covariance)[np.ix_(own, own)]
    away = np.array(joint.value)[own] - true
    limit = float(stats.chi2.ppf(SHARE, len(own)))
    scaled = covariance / np.outer(true - null, true - null)
    width = math.sqrt(limit) * float(np.linalg.det(scaled)) ** (0.5 / len(own))
    return Ellipsoid(bool(away @ np.linalg.solve(covariance, away) <= limit), width)


def _full(name: str) -> str:
    return main_part(name) if bare(name) in _CAUSES else name


_CAUSES: Final[Mapping[str, None]] = {term.cause: None for term in TERMS.values()}
