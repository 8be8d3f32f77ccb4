"""A diagnosis in a few lines for the terminal."""

import textwrap

from hilserver.diagnosis.findings.explain import QUANTITIES, explain_finding, number
from hilserver.diagnosis.report.words import Change, headline, is_unchanged, shared_and_free
from hilserver.diagnosis.schema.findings import Findings, Overall

WIDTH = 96


def summary(findings: Findings) -> str:
    """Return what was found, what it gains and what to do."""
    lines = [headline(findings)]
    named = findings.findings
    if len(named) > 1 or (named and explain_finding(named[0]) != lines[0]):
        lines += [f"- {explain_finding(item)}" for item in named]
    lines += [
        f"  To tell them apart: {item.separating_experiment}"
        for item in named
        if item.separating_experiment
    ]
    lines += [f"  {text}" for text in shared_and_free(findings)]
    for key, gain in findings.total_gain.items():
        name, unit = QUANTITIES.get(key, (key, "1"))
        if is_unchanged(gain):
            continue
        lines.append(
            f"  Error of the {name} after {number(gain.horizon_s, 's')}:"
            f" {number(gain.before, unit, digits=2)} to {number(gain.after, unit, digits=2)}"
            f" ({Change.of(gain)})"
        )
    if findings.verdict is Overall.NOTHING_FOUND and findings.smallest_detectable:
        lines.append("  The report says how large an effect must be to be found.")
    lines += [f"  Note: {notice}" for notice in findings.notices]
    return "\n".join(
        textwrap.fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False) for line in lines
    )


def one_line(findings: Findings) -> str:
    """Return the verdict on one of many logs."""
    causes = [" or ".join(f.causes) or str(f.verdict) for f in findings.findings]
    return f"{findings.verdict}: {', '.join(causes)}" if causes else str(findings.verdict)
