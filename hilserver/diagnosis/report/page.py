"""The whole page: words first, then plots, then the evidence."""

import re
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from itertools import zip_longest
from typing import Any, Final

from jinja2 import Environment, PackageLoader, StrictUndefined
from markupsafe import Markup, escape

from hilserver.diagnosis.findings.explain import QUANTITIES, explain_finding, number
from hilserver.diagnosis.report import figures, tables, words
from hilserver.diagnosis.report.marked_ends import marked_ends
from hilserver.diagnosis.report.plain import plain
from hilserver.diagnosis.report.time_series import improvement, series
from hilserver.diagnosis.schema.evidence import (
    ChannelSeries,
    Evidence,
    MarkedEnds,
    Path,
)
from hilserver.diagnosis.schema.findings import Findings, Verdict
from hilserver.diagnosis.thresholds import SCREEN_LEVEL

# share of a residual below which a channel counts as not changed
LEAST_CHANGE: Final = 0.03
_SECTION: Final = re.compile(r'<section id="(\w+)">.*?<h2>(.*?)</h2>', re.DOTALL)
_CELL: Final = re.compile(r"<td\b")
STYLES: Final = ("plot.css", "style.css")
MODELS: Final = (
    ("measured", "measured"),
    ("simulated", "simulated: the plant as it is configured"),
    (
        "extended",
        "extended: the same plant with the causes found in the other half of the log",
    ),
)


def render(findings: Findings, evidence: Evidence) -> str:
    """Return the report as one HTML file without any reference to the network.

    Parameters
    ----------
    findings : Findings
        What was found.
    evidence : Evidence
        The evidence for it; empty parts are left out.
    """
    gains = words.gains(findings)
    drawn: list[ChannelSeries | Path | MarkedEnds] = [*evidence.series, *evidence.paths]
    if evidence.marked_ends is not None:
        drawn.append(evidence.marked_ends)
    extended = any(item.extended is not None for item in drawn)
    return (
        environment()
        .get_template("page.html.j2")
        .render(
            findings=findings,
            evidence=evidence,
            plots=_plots(evidence),
            models=MODELS if extended else MODELS[:2],
            headline=words.headline(findings),
            best=words.best(gains),
            held_out=words.held_out(findings),
            understated=words.understated(findings) if findings.total_gain else "",
            changed=[g for g in gains if not words.is_unchanged(g.gain)],
            unchanged=[g for g in gains if words.is_unchanged(g.gain)],
            causes=[
                f for f in findings.findings if f.verdict is not Verdict.DATA_FAULT
            ],
            faults=[f for f in findings.findings if f.verdict is Verdict.DATA_FAULT],
            steps=words.steps(findings),
            where=words.where(evidence.cuts),
            screen=sorted(
                evidence.screen, key=lambda r: -abs(r.statistic) / r.critical
            ),
            selected=tables.selected(findings),
            shared=words.belonging(findings, differs=False),
            free=words.belonging(findings, differs=True),
            joint=tables.together(findings.joint),
            noises=tables.noises(findings),
            twins=tables.twins(evidence.similarity),
            unjudged=tables.by_reason(findings.not_judged),
            notes=(*findings.notices, *evidence.remarks),
        )
    )


def _plots(evidence: Evidence) -> dict[str, Any]:
    """Draw everything; the channels that the extension changes most come first.

    `same` are those that it does not change.
    """
    drawn = sorted(
        (s for s in evidence.series if len(s.t_s) > 1), key=lambda s: -improvement(s)
    )
    is_changed = [
        s.extended is None or improvement(s) > 1 + LEAST_CHANGE for s in drawn
    ]
    like, ends = evidence.similarity, evidence.marked_ends
    return {
        "paths": figures.paths(evidence.paths),
        "ends": None if ends is None else marked_ends(ends),
        "changed": [series(s) for s, c in zip(drawn, is_changed, strict=True) if c],
        "same": [series(s) for s, c in zip(drawn, is_changed, strict=True) if not c],
        "horizons": figures.horizons(evidence.gain_by_horizon),
        "courses": [figures.course(c) for c in evidence.courses],
        "rest": [figures.dependence(d) for d in evidence.dependences],
        "likeness": None if like is None else figures.likeness(like),
    }


def _contents(main: str) -> list[tuple[str, Markup]]:
    """Return id and title of every section."""
    found = _SECTION.findall(main)
    return [(name, Markup(title)) for name, title in found]  # noqa: S704 - escaped already


def _headed(cells: str, head: Sequence[str]) -> Markup:
    """Label every cell of a row with its column, because a phone shows rows as blocks."""
    heads = iter(head)
    text = _CELL.sub(lambda _: f'<td data-head="{escape(next(heads))}"', cells)
    return Markup(text)  # noqa: S704 - escaped already


@cache
def environment() -> Environment:
    """Return the template environment: filters, style and words."""
    made = Environment(
        loader=PackageLoader("hilserver.diagnosis.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    folder = files("hilserver.diagnosis.report")
    style = "".join(
        folder.joinpath(name).read_text(encoding="utf-8") for name in STYLES
    )
    made.globals |= {
        "style": Markup(style),  # noqa: S704 - our own
        "badges": words.BADGES,
        "cut_points": tables.CUT_POINTS,
        "quantity": QUANTITIES.__getitem__,
        "screen_level": SCREEN_LEVEL,
    }
    made.filters |= {
        "number": number,
        "sentence": explain_finding,
        "plain": plain,
        "change": words.RatioInWords.of,
        "contents": _contents,
        "headed": _headed,
        "interval": figures.interval,
        "in_pairs": lambda columns: list(zip_longest(*columns)),
    }
    made.tests["large"] = words.is_large
    return made
