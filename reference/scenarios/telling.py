"""A scenario in words: what happens, what was hidden, what the diagnosis says, what to do."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from textwrap import fill
from typing import Final

import yaml
from hilserver_injector import Recipe
from jinja2 import Environment, PackageLoader, StrictUndefined, Template

from hilserver.diagnosis.findings.explain import QUANTITIES, number
from hilserver.diagnosis.schema.findings import Finding, Findings, Parameter, Verdict
from hilserver.scenarios.expectation import ScenarioDrive, ThesisScenario
from reference.scenarios.judging import judge

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
    text = (
        files("reference.scenarios").joinpath("words.yaml").read_text(encoding="utf-8")
    )
    return {name: Words(**entry) for name, entry in yaml.safe_load(text).items()}


def section(
    scenario: ThesisScenario, drive: ScenarioDrive, findings: Findings, picture: str
) -> str:
    """Return the section of a scenario in Markdown; `picture` is the file of its plot."""
    reported = [
        f for f in findings.findings if f.verdict is not Verdict.INSUFFICIENT_EXCITATION
    ]
    better = {k: g for k, g in findings.total_gain.items() if g.ratio > 1.0}
    best = max(better, key=lambda key: better[key].ratio) if better else None
    text = _template().render(
        name=scenario.name,
        says=scenario.says,
        words=words()[scenario.name],
        picture=picture,
        hidden=_hidden(drive),
        findings=findings,
        reported=reported,
        rows=[row for f in reported for row in _rows(f, drive)],
        gain=better.get(best) if best else None,
        quantity=QUANTITIES.get(best, (best, "1")) if best else None,
        judgement=judge(drive.expectation, findings),
        experiments=_experiments(findings),
    )
    return "\n\n".join(map(wrapped, text.strip().split("\n\n"))) + "\n"


@cache
def _template() -> Template:
    environment = Environment(  # noqa: S701 - Markdown, of our own words and names
        loader=PackageLoader("reference.scenarios"),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["number"] = number
    return environment.get_template("section.md.j2")


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


def _hidden(drive: ScenarioDrive) -> str:
    faults = {k: v for recipe in drive.logs.values() for k, v in recipe.faults.items()}
    if drive.hidden == str(faults):
        return "; ".join(f"{name} of {_listed(what)}" for name, what in faults.items())
    return drive.hidden


def _listed(what: object) -> str:
    parts = what if isinstance(what, tuple) else (what,)
    return " and ".join(f"{p:.4g}" if isinstance(p, float) else f"`{p}`" for p in parts)


def _rows(
    finding: Finding, drive: ScenarioDrive
) -> list[tuple[str, Parameter, float | None]]:
    """Return the parameters with an interval, and the true values."""
    return [
        (name, p, hidden_value(name, finding, drive))
        for name, p in finding.parameters.items()
        if p.ci95 is not None
    ]


def hidden_value(name: str, finding: Finding, drive: ScenarioDrive) -> float | None:
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
    return (
        None if first is None and second is None else (second or 0.0) - (first or 0.0)
    )


def _mean(name: str, recipes: Mapping[str, Recipe]) -> float | None:
    values = [recipe.causes.get(name) for recipe in recipes.values()]
    known = [float(v) for v in values if v is not None]
    return sum(known) / len(known) if known else None


def _experiments(findings: Findings) -> list[str]:
    texts = [
        f.separating_experiment for f in findings.findings if f.separating_experiment
    ]
    return list(dict.fromkeys(texts))
