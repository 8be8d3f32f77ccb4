"""The whole page: words first, then plots, then the evidence."""

from html import escape
from importlib.resources import files

from hilserver.diagnosis.evidence import Evidence
from hilserver.diagnosis.findings import Finding, Findings, Verdict
from hilserver.diagnosis.report import figures, markup, tables, words
from hilserver.diagnosis.report.markup import section
from hilserver.diagnosis.report.time_series import improvement, series

LEAST_CHANGE = 0.03
"""Share of a residual below which a channel counts as not changed."""
STYLES = ("plot.css", "style.css")
MODELS = (
    ("measured", "measured"),
    ("simulated", "simulated: the plant as it is configured"),
    ("extended", "extended: the same plant with the terms that were found"),
)


def render(findings: Findings, evidence: Evidence) -> str:
    """Return the report as one HTML file without any reference to the network.

    Parameters
    ----------
    findings : Findings
        What was found.
    evidence : Evidence
        What stands behind it; empty parts are left out.
    """
    folder = files("hilserver.diagnosis.report")
    parts = (folder.joinpath(name).read_text(encoding="utf-8") for name in STYLES)
    style = "".join(parts)
    title = escape(words.headline(findings))
    body = "".join((_first_page(findings), _plots(evidence), _behind(findings, evidence)))
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        '<meta name="color-scheme" content="light dark">'
        f"<title>{title}</title><style>{style}</style></head><body>"
        f"<header>{_header(findings)}</header><main>{body}</main>"
        f"<footer>hilserver {escape(findings.version)}. All figures of this page stand in"
        " findings.json beside it.</footer></body></html>\n"
    )


def _header(findings: Findings) -> str:
    names = [log.file for log in findings.logs]
    shown = ", ".join(names[:4]) + (f" and {len(names) - 4} more" if len(names) > 4 else "")
    lede = words.lede(findings)
    return (
        f'<p class="eyebrow"><b>Diagnosis</b> &ensp;{escape(shown)}</p>'
        f"<h1>{escape(words.headline(findings))}</h1>"
        + (f'<p class="lede">{lede}</p>' if lede else "")
        + words.tiles(findings)
    )


def _first_page(findings: Findings) -> str:
    faults = [f for f in findings.findings if f.verdict is Verdict.DATA_FAULT]
    others = [f for f in findings.findings if f.verdict is not Verdict.DATA_FAULT]
    return "".join(
        (
            section("found", "What is wrong, and why", "", _list(others)),
            section(
                "data",
                "Faults of the recording",
                "They were corrected before anything else was judged. They say nothing about the"
                " robot.",
                _list(faults),
            ),
            section("do", "What to do", "", words.steps(findings)),
        )
    )


def _list(items: list[Finding]) -> str:
    if not items:
        return ""
    return f'<ol class="findings">{"".join(map(words.finding, items))}</ol>'


def _plots(evidence: Evidence) -> str:
    with_extension = any(s.extended is not None for s in evidence.series) or any(
        p.extended is not None for p in evidence.paths
    )
    key = markup.legend(MODELS if with_extension else MODELS[:2])
    ways = figures.paths(evidence.paths)
    channels = _channels(evidence)
    gains = figures.horizons(evidence.gain_by_horizon)
    courses = [figures.course(c) for c in evidence.courses]
    rest = [figures.dependence(d) for d in evidence.dependences]
    return "".join(
        (
            section("paths", "The way over the floor", "", key + markup.grid(ways) if ways else ""),
            section(
                "channels",
                "Every channel over time",
                "Above the values, below what the models leave unexplained.",
                key + channels if channels else "",
            ),
            section(
                "gain",
                "How much better, and how far ahead",
                "The model runs freely from held-out points of the recording; the error is taken"
                " at the end of the run. Bars are intervals of 95 %.",
                markup.grid(gains) if gains else "",
            ),
            section("courses", "Over time", "", markup.grid(courses) if courses else ""),
            section(
                "rest",
                "What remains",
                "The error that the extended model leaves, against what it could depend on.",
                markup.grid(rest) if rest else "",
            ),
        )
    )


def _channels(evidence: Evidence) -> str:
    """Return the channels that the extension changes, the most first; the others folded away."""
    drawn = [s for s in evidence.series if len(s.t_s) > 1]
    drawn.sort(key=lambda s: -improvement(s))
    changed = [s for s in drawn if s.extended is None or improvement(s) > 1 + LEAST_CHANGE]
    others = [s for s in drawn if all(s is not c for c in changed)]
    shown = markup.grid(map(series, changed or others))
    if changed and others:
        shown += (
            "<details><summary>Channels that the extension does not change:"
            f" {escape(', '.join(s.name for s in others))}</summary>"
            f"{markup.grid(map(series, others))}</details>"
        )
    return shown if drawn else ""


def _behind(findings: Findings, evidence: Evidence) -> str:
    rounds = sorted({r.round for r in evidence.screen} - {0})
    later = "".join(
        f"<details><summary>After {k} cause{'s' * (k > 1)} taken up</summary>"
        f"{tables.screen(evidence.screen, k)}</details>"
        for k in rounds
    )
    like = "" if evidence.similarity is None else figures.likeness(evidence.similarity)
    where = words.where(evidence.cuts)
    spectra = [s for row in evidence.noise if (s := figures.spectrum(row))]
    return "".join(
        (
            section(
                "cuts",
                "In which block",
                "The recording is replayed from three points. Where the residual is larger than"
                f" the sensors' noise, something before that channel is wrong. {where}".rstrip(),
                tables.cuts(evidence.cuts),
            ),
            section(
                "screen",
                "All causes that were looked for",
                "A bar in colour exceeds its critical value; with nothing hidden that happens to"
                " any of them in at most one of a hundred recordings.",
                tables.screen(evidence.screen) + later,
            ),
            section("selection", "What was taken up", "", tables.selection(evidence.selection)),
            section(
                "twins",
                "What these data can tell apart",
                "",
                like + tables.twins(evidence.similarity),
            ),
            section(
                "noise",
                "The sensors' noise",
                "White noise plus noise that is correlated in time, as the residuals show it.",
                tables.noise(evidence.noise) + (markup.grid(spectra) if spectra else ""),
            ),
            section(
                "sizes",
                "The smallest effects that would have been seen",
                "A smaller one may be there: these data would not show it.",
                tables.detectable(findings),
            ),
            section("unjudged", "Not judged", "", tables.not_judged(findings)),
            section(
                "origin",
                "Where this comes from",
                "",
                tables.baseline(findings) + tables.provenance(findings, evidence),
            ),
        )
    )
