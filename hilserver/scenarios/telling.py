"""A scenario in words: what happens, what was hidden, what the diagnosis says, what to do."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from textwrap import fill
from typing import Final

import yaml
from hilserver_injector import Recipe

from hilserver.diagnosis.explain import QUANTITIES, number
from hilserver.diagnosis.findings import Finding, Findings, Verdict
from hilserver.scenarios.expectation import Drive, Scenario, judge

COLUMNS: Final = 100


@dataclass(frozen=True, slots=True)
class Words:
    """What a person adds to a scenario."""

    title: str
    happens: str
    seen: str
    do: str


@cache
def words() -> Mapping[str, Words]:
    """Return the words of every scenario."""
    text = files("hilserver.scenarios").joinpath("words.yaml").read_text(encoding="utf-8")
    return {name: Words(**entry) for name, entry in yaml.safe_load(text).items()}


def section(scenario: Scenario, drive: Drive, findings: Findings, picture: str) -> str:
    """Return the section of a scenario in Markdown; `picture` is the file of its plot."""
    own = words()[scenario.name]
    paragraphs = [
        f"## `{scenario.name}`",
        f"The thesis: {scenario.says}.",
        own.happens,
        f"![{own.title}]({picture})",
        own.seen,
        f"**Hidden:** {_hidden(drive)}.",
        *_said(drive, findings),
        f"**What to do:** {own.do}",
        *(f"**To tell them apart:** {text}" for text in _experiments(findings)),
    ]
    return "\n\n".join(map(wrapped, paragraphs)) + "\n"


def wrapped(paragraph: str) -> str:
    """Return a paragraph of Markdown in lines of the documents' width; tables stay as they are."""
    if paragraph.startswith(("|", "![")):
        return paragraph
    lines = []
    for line in paragraph.split("\n"):
        indent = "  " if line.startswith("- ") else ""
        lines.append(
            fill(
                line,
                COLUMNS,
                subsequent_indent=indent,
                break_long_words=False,
                break_on_hyphens=False,
            )
        )
    return "\n".join(lines)


def _hidden(drive: Drive) -> str:
    faults = {k: v for recipe in drive.logs.values() for k, v in recipe.faults.items()}
    if drive.hidden == str(faults):
        return "; ".join(f"{name} of {_listed(what)}" for name, what in faults.items())
    return drive.hidden


def _listed(what: object) -> str:
    parts = what if isinstance(what, tuple) else (what,)
    return " and ".join(f"{p:.4g}" if isinstance(p, float) else f"`{p}`" for p in parts)


def _said(drive: Drive, findings: Findings) -> list[str]:
    """Return the verdict, the sentences, the values beside the truth, and the gain."""
    told = [f for f in findings.findings if f.verdict is not Verdict.INSUFFICIENT_EXCITATION]
    lines = [f"**The diagnosis says:** `{findings.verdict}`."]
    lines += [f"- {_named(f)} {f.explanation}" for f in told]
    parts = ["\n".join([lines[0], "", *lines[1:]]) if told else lines[0]]
    rows = [row for f in told for row in _rows(f, drive)]
    if rows:
        head = ["| parameter | found | 95 % | hidden |", "|---|---|---|---|"]
        parts.append("\n".join(head + rows))
    if gained := _gain(findings):
        parts.append(gained)
    result = judge(drive.expectation, findings)
    if not result.right:
        wrong = [f"{name} was not hidden" for name in result.wrong]
        parts.append(f"**Not as it should be:** {'; '.join((*result.missing, *wrong))}.")
    return parts


def _named(finding: Finding) -> str:
    names = ", ".join(f"`{cause}`" for cause in finding.causes)
    return f"`{finding.verdict}`: {names}." if names else f"`{finding.verdict}`."


def _rows(finding: Finding, drive: Drive) -> list[str]:
    rows = []
    for name, p in finding.parameters.items():
        if p.ci95 is None:
            continue
        low, high = (number(v, digits=4) for v in p.ci95)
        truth = hidden_value(name, finding, drive)
        hidden = "" if truth is None else number(truth, p.unit, digits=4)
        rows.append(
            f"| `{name}` | {number(p.value, p.unit, digits=4)} | {low} to {high} | {hidden} |"
        )
    return rows


def hidden_value(name: str, finding: Finding, drive: Drive) -> float | None:
    """Return the true value of a parameter: the mean over the runs; None where none is hidden."""
    first, second = (_mean(name, drive.logs), _mean(name, drive.against))
    if finding.verdict is not Verdict.DIFFERS:
        return first
    own, _, side = name.rpartition(".")
    if side in ("a", "b") and own:
        means = _mean(own, drive.logs), _mean(own, drive.against)
        if means == (None, None):
            return None
        return (means[0] if side == "a" else means[1]) or 0.0
    return None if first is None and second is None else (second or 0.0) - (first or 0.0)


def _mean(name: str, recipes: Mapping[str, Recipe]) -> float | None:
    values = [recipe.causes.get(name) for recipe in recipes.values()]
    known = [float(v) for v in values if v is not None]
    return sum(known) / len(known) if known else None


def _gain(findings: Findings) -> str:
    better = {k: g for k, g in findings.total_gain.items() if g.ratio > 1.0}
    if not better:
        return ""
    key, gain = max(better.items(), key=lambda item: item[1].ratio)
    name, unit = QUANTITIES.get(key, (key, "1"))
    sure = ""
    if gain.ci95 is not None:
        low, high = (number(v, digits=2) for v in gain.ci95)
        sure = f", 95 % {low} to {high}"
    return (
        f"With the extended model the error in {name} after {number(gain.horizon_s)} s falls from"
        f" {number(gain.before, unit, digits=2)} to {number(gain.after, unit, digits=2)}"
        f" ({number(gain.ratio, digits=2)} times smaller{sure})."
    )


def _experiments(findings: Findings) -> list[str]:
    texts = [f.separating_experiment for f in findings.findings if f.separating_experiment]
    return list(dict.fromkeys(texts))
