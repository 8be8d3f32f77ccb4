"""What the tables of a report show, chosen and sorted from findings and evidence."""

from collections.abc import Iterable
from typing import Any, Final

import numpy as np

from hilserver.diagnosis.schema.evidence import Similarity
from hilserver.diagnosis.schema.findings import Findings, Joint, NotJudged
from hilserver.measured.names import signal_unit

CUT_POINTS: Final = {
    "setpoints": "From the set-points: the whole chain",
    "duty": "From the measured duty: motor, gear and load",
    "speed": "From the measured wheel speed: kinematics and sensors",
}
MAX_TWINS: Final = 40
Row = dict[str, Any]  # cells of a table's row, by name


def selected(findings: Findings) -> list[Row]:
    """Return every decision of the selection; the last one on a cause comes with its finding."""
    in_the_end = {cause: f for f in findings.findings for cause in f.causes}
    out: list[Row] = []
    for row in reversed(findings.decisions):
        p = size = None
        if found := in_the_end.pop(row.cause, None):
            own = (
                v
                for n, v in found.parameters.items()
                if n.partition(".")[0] == row.cause
            )
            p, size = found.p_adjusted, next(own, None)
        reason = f"{row.group}: {row.reason}" if row.group else row.reason
        out.append({"cause": row.cause, "action": row.action, "reason": reason, "p": p,
                    "parameter": size})  # fmt: skip
    return out[::-1]


def twins(similarity: Similarity | None) -> list[tuple[float, str, str]]:
    """Return cosine and names of the pairs that these data cannot tell apart."""
    if similarity is None:
        return []
    names, cosine = similarity.names, similarity.cosine
    close = np.argwhere(np.triu(np.abs(cosine) > similarity.limit, 1)).tolist()
    pairs = [(float(cosine[i, j]), names[i], names[j]) for i, j in close]
    return sorted(pairs, key=lambda pair: -abs(pair[0]))[:MAX_TWINS]


def noises(findings: Findings) -> list[Row]:
    """Return what every channel shows, separately for each group."""
    of_groups = [(f" ({name})", g.noise) for name, g in (findings.groups or {}).items()]
    return [
        {"channel": f"{channel}{group}", "unit": signal_unit(channel), "noise": noise}
        for group, found in of_groups or [("", findings.noise)]
        for channel, noise in found.items()
    ]


def by_reason(not_judged: Iterable[NotJudged]) -> dict[str, list[str]]:
    """Return, by reason, the causes about which the data say nothing."""
    reasons: dict[str, list[str]] = {}
    for item in not_judged:
        reasons.setdefault(item.reason, []).append(item.cause)
    return reasons


def together(joint: Joint | None) -> list[Row]:
    """Return all fitted parameters, each with the most strongly correlated other one."""
    if joint is None:
        return []
    covariance = np.array(joint.covariance)
    deviation = np.sqrt(np.diag(covariance))
    correlation = covariance / np.maximum(np.outer(deviation, deviation), 1e-300)
    np.fill_diagonal(correlation, 0.0)
    return [
        {"name": name, "value": joint.value[i], "deviation": float(deviation[i]),
         "partner": joint.parameters[j] if i != j else "", "correlation": float(correlation[i, j])}
        for i, (name, j) in enumerate(
            zip(joint.parameters, np.argmax(np.abs(correlation), axis=1).tolist(), strict=True)
        )
    ]  # fmt: skip
