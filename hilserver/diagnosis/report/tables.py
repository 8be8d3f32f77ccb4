"""The tables behind a report, from findings and evidence."""

from collections.abc import Sequence
from html import escape

from hilserver.diagnosis.decisions import ScreenRow, SelectionRow
from hilserver.diagnosis.evidence import (
    CutRow,
    Evidence,
    NoiseRow,
    Similarity,
)
from hilserver.diagnosis.explain import number
from hilserver.diagnosis.findings import Findings
from hilserver.diagnosis.report.markup import bar, code, table
from hilserver.diagnosis.report.words import is_large

CUTS = {
    "setpoints": ("From the set-points", "the whole chain"),
    "duty": ("From the measured duty", "motor, gear and load"),
    "speed": ("From the measured wheel speed", "kinematics and sensors"),
}


def cuts(rows: Sequence[CutRow]) -> str:
    """Return the residuals by the point where the replay begins."""
    if not rows:
        return ""

    def row(item: CutRow) -> list[str]:
        title, what = CUTS.get(item.cut, (item.cut, ""))
        excess = None if not item.expected else item.rms / item.expected
        return [
            f"{escape(title)}: {escape(what)}",
            code(item.channel),
            number(item.rms, item.unit),
            "" if item.expected is None else number(item.expected, item.unit),
            "" if excess is None else number(excess, digits=2),
            "" if excess is None else bar(excess / 10, "simulated" if is_large(item) else ""),
        ]

    head = ("Replayed", "channel", "residual, rms", "noise alone", "ratio", "")
    return table(head, map(row, rows), numbers=(2, 3, 4))


def screen(rows: Sequence[ScreenRow], number_of_round: int = 0) -> str:
    """Return all causes of one round, the strongest first."""
    chosen = [r for r in rows if r.round == number_of_round]
    if not chosen:
        return ""
    chosen.sort(key=lambda r: -abs(r.statistic) / r.critical)
    largest = max(abs(chosen[0].statistic) / chosen[0].critical, 1.0)

    def row(item: ScreenRow) -> list[str]:
        share = abs(item.statistic) / item.critical
        return [
            code(f"{item.cause}.{item.part}" if item.part else item.cause),
            bar(share / largest, "over" if share > 1 else ""),
            number(item.statistic, digits=3),
            number(item.critical, digits=3),
            "&lt; 0.0001" if item.p_adjusted < 1e-4 else number(item.p_adjusted, digits=2),
            f"{number(item.size, digits=2)} ± {number(item.standard_error, item.unit, digits=2)}",
            number(item.dof, digits=3),
        ]

    head = ("cause", "", "statistic", "critical", "p adjusted", "size alone", "dof")
    return table(head, map(row, chosen), numbers=(2, 3, 4, 5, 6))


def selection(rows: Sequence[SelectionRow]) -> str:
    """Return what was taken up and what was refused."""
    if not rows:
        return ""
    cells = [
        [
            code(r.cause),
            escape(r.action),
            "" if r.held_out_gain is None else number(r.held_out_gain),
            escape(r.reason),
        ]
        for r in rows
    ]
    return table(("cause", "decision", "held-out gain", "because"), cells, numbers=(2,))


def noise(rows: Sequence[NoiseRow]) -> str:
    """Return the noise model of every channel."""
    if not rows:
        return ""
    cells = [
        [
            code(r.channel),
            number(r.white, r.unit),
            number(r.correlated, r.unit) if r.correlated else "none",
            "" if r.tau_s is None else number(r.tau_s, "s"),
            "Gaussian" if r.tail_dof is None else f"Student's t, {number(r.tail_dof, digits=2)}",
        ]
        for r in rows
    ]
    head = ("channel", "white", "correlated", "over", "tails")
    return table(head, cells, numbers=(1, 2, 3))


def twins(similarity: Similarity | None) -> str:
    """Return the pairs that these data cannot tell apart."""
    if similarity is None:
        return ""
    n = len(similarity.names)
    pairs = [
        (float(similarity.cosine[i, j]), similarity.names[i], similarity.names[j])
        for i in range(n)
        for j in range(i + 1, n)
        if abs(similarity.cosine[i, j]) > similarity.limit
    ]
    pairs.sort(key=lambda pair: -abs(pair[0]))
    cells = [[code(a), code(b), number(value)] for value, a, b in pairs[:40]]
    return table(("cause", "looks like", "cosine"), cells, numbers=(2,)) if cells else ""


def detectable(findings: Findings) -> str:
    """Return the smallest effect of each cause that would have been seen."""
    if not findings.smallest_detectable:
        return ""
    cells = [
        [code(d.cause), number(d.size, d.unit, digits=2)] for d in findings.smallest_detectable
    ]
    half = (len(cells) + 1) // 2
    left, right = cells[:half], [*cells[half:], ["", ""]]
    rows = [a + b for a, b in zip(left, right, strict=False)]
    return table(("cause", "size", "cause", "size"), rows, numbers=(1, 3))


def not_judged(findings: Findings) -> str:
    """Return the causes that the data say nothing about, by reason."""
    reasons: dict[str, list[str]] = {}
    for item in findings.not_judged:
        reasons.setdefault(item.reason, []).append(code(item.cause))
    rows = [[escape(reason), ", ".join(causes)] for reason, causes in reasons.items()]
    return table(("because", "not judged"), rows) if rows else ""


def baseline(findings: Findings) -> str:
    """Return the errors of the configured plant."""
    rows = [[code(key), number(value)] for key, value in findings.baseline.items()]
    return table(("error of the configured plant", "mean"), rows, numbers=(1,)) if rows else ""


def provenance(findings: Findings, evidence: Evidence) -> str:
    """Return which data, which program and how long."""
    logs = "<br>".join(f"{escape(log.file)} ({code(log.sha256[:16])})" for log in findings.logs)
    times = ", ".join(
        f"{escape(k)} {number(v, 's', digits=2)}" for k, v in evidence.timings_s.items()
    )
    entries = {
        "Data": logs,
        "Configuration": code(findings.config_sha256),
        "Program": f"hilserver {escape(findings.version)}, seed {findings.seed}",
        "Time": times,
        "Notes": "<br>".join(map(escape, (*findings.notices, *evidence.remarks))),
    }
    items = "".join(f"<dt>{k}</dt><dd>{v}</dd>" for k, v in entries.items() if v)
    return f"<dl>{items}</dl>"
