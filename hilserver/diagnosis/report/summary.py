"""A diagnosis in a few lines for the terminal."""

import textwrap

from hilserver.diagnosis.findings.explain import explain_finding, number
from hilserver.diagnosis.report import words
from hilserver.diagnosis.schema.findings import Findings, Overall

WIDTH = 96


def summary(findings: Findings) -> str:
    """Return what was found, what it gains and what to do."""
    lines = [words.headline(findings)]
    named = findings.findings
    if len(named) > 1 or (named and explain_finding(named[0]) != lines[0]):
        lines += [f"- {explain_finding(item)}" for item in named]
    lines += [
        f"  To tell them apart: {item.separating_experiment}"
        for item in named
        if item.separating_experiment
    ]
    lines += [f"  {text}" for text in words.shared_and_free(findings)]
    lines += [
        f"  {' '.join(filter(None, ('Error of the', g.name, g.when)))}:"
        f" {number(g.gain.before, g.unit, digits=2)} to {number(g.gain.after, g.unit, digits=2)}"
        f" ({words.RatioInWords.of(g.gain)})"
        for g in words.gains(findings)
        if not words.is_unchanged(g.gain)
    ]
    if findings.total_gain and (text := words.understated(findings)):
        lines.append(f"  {text}")
    if findings.verdict is Overall.NOTHING_FOUND and findings.smallest_detectable:
        lines.append("  The report shows how large an effect must be to be detected.")
    lines += [f"  Note: {notice}" for notice in findings.notices]
    return "\n".join(
        textwrap.fill(line, WIDTH, subsequent_indent="  ", break_on_hyphens=False)
        for line in lines
    )


def one_line(findings: Findings) -> str:
    """Return the verdict on one of many logs."""
    causes = [" or ".join(f.causes) or str(f.verdict) for f in findings.findings]
    if findings.verdict is Overall.NOTHING_FOUND and causes:
        return ", ".join(causes)  # too little motion for a verdict
    return (
        f"{findings.verdict}: {', '.join(causes)}" if causes else str(findings.verdict)
    )
