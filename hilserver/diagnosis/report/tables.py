"""What the tables behind a report show, chosen and sorted from findings and evidence."""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.diagnosis.schema.evidence import Similarity
from hilserver.diagnosis.schema.findings import Findings, Joint, NotJudged, Parameter

CUT_POINTS: Final = {
    "setpoints": "From the set-points: the whole chain",
    "duty": "From the measured duty: motor, gear and load",
    "speed": "From the measured wheel speed: kinematics and sensors",
}
MAX_TWINS: Final = 40


@dataclass(frozen=True, slots=True)
class Selected:
    """A decision of the selection, and what the findings say of the cause in the end."""

    cause: str
    action: str
    reason: str
    p: float | None = None
    parameter: Parameter | None = None


def selected(findings: Findings) -> list[Selected]:
    """Return every decision of the selection; the last one on a cause with its finding."""
    in_the_end = {cause: f for f in findings.findings for cause in f.causes}
    out: list[Selected] = []
    for row in reversed(findings.decisions):
        p = size = None
        if found := in_the_end.pop(row.cause, None):
            own = (v for n, v in found.parameters.items() if n.partition(".")[0] == row.cause)
            p, size = found.p_adjusted, next(own, None)
        reason = f"{row.group}: {row.reason}" if row.group else row.reason
        out.append(Selected(row.cause, row.action, reason, p, size))
    return out[::-1]


def twins(similarity: Similarity | None) -> list[tuple[float, str, str]]:
    """Return cosine and names of the pairs that these data cannot tell apart."""
    if similarity is None:
        return []
    n = len(similarity.names)
    pairs = [
        (float(similarity.cosine[i, j]), similarity.names[i], similarity.names[j])
        for i in range(n)
        for j in range(i + 1, n)
        if abs(similarity.cosine[i, j]) > similarity.limit
    ]
    return sorted(pairs, key=lambda pair: -abs(pair[0]))[:MAX_TWINS]


def by_reason(not_judged: Iterable[NotJudged]) -> dict[str, list[str]]:
    """Return the causes that the data say nothing about, by reason."""
    reasons: dict[str, list[str]] = {}
    for item in not_judged:
        reasons.setdefault(item.reason, []).append(item.cause)
    return reasons


@dataclass(frozen=True, slots=True)
class JointRow:
    """One fitted parameter and the one whose estimate is most correlated with it."""

    name: str
    value: float
    deviation: float
    partner: str
    correlation: float


def together(joint: Joint | None) -> list[JointRow]:
    """Return all fitted parameters with what their estimates have to do with each other."""
    if joint is None:
        return []
    covariance = np.array(joint.covariance)
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.maximum(np.outer(deviation, deviation), 1e-300)
    np.fill_diagonal(correlation, 0.0)
    rows = []
    for i, (name, value) in enumerate(zip(joint.parameters, joint.value, strict=True)):
        j = int(np.argmax(np.abs(correlation[i])))
        partner = joint.parameters[j] if j != i else ""
        rows.append(JointRow(name, value, float(deviation[i]), partner, float(correlation[i, j])))
    return rows
