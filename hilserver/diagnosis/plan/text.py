"""A plan in words for the terminal."""

import textwrap
from collections.abc import Iterable

from hilserver.diagnosis.findings.explain import number
from hilserver.diagnosis.plan.document import PlanDocument, Prospect, Visible
from hilserver.diagnosis.plan.null_log import GROUPS

WIDTH = 96


def lines(document: PlanDocument) -> list[str]:
    """Return what a user should know."""
    planned, proposed = document.as_planned, document.proposed
    short = [
        name
        for name, signals in GROUPS.items()
        if set(signals) & set(document.channels)
    ]
    if document.satellites_m is not None and "position" in short:
        by = f"position by satellites ({document.satellites_m:g} m, no heading)"
        short[short.index("position")] = by
    out = [
        f"Recorded: set-points, {', '.join(short)}; {document.rate_hz:g} rows per second"
    ]
    out += [f"Note: {notice}" for notice in document.notices]
    out += ["", f"{document.manoeuvre}, {planned.duration_s:.0f} s: {_count(planned)}"]
    out += _prospect(planned)
    for missing in document.missing_channels:
        gain = [f"shows {', '.join(missing.shows)}"] if missing.shows else []
        gain += (
            [f"separates {', '.join(missing.separates)}"] if missing.separates else []
        )
        out += _wrapped(
            f"also with {missing.channel}: ", " and ".join(gain) or "nothing more"
        )
    if not proposed.better:
        return [*out, "", "No better manoeuvre was found for this time and room."]
    out += ["", f"Proposed, {proposed.duration_s:.0f} s: {_count(proposed)}"]
    out += _prospect(proposed)
    return [*out, *_wrapped("pieces: ", "; ".join(_counted(proposed.pieces)))]


def _count(prospect: Prospect) -> str:
    shown = [v.cause for v in prospect.causes if v.shows]
    grouped = {c for group in prospect.groups for c in group.causes}
    alone = sum(cause not in grouped for cause in shown)
    causes = "1 cause at its" if len(shown) == 1 else f"{len(shown)} causes at their"
    return f"shows {causes} reference size, {alone} of them not in a group"


def _prospect(prospect: Prospect) -> list[str]:
    out = _wrapped("shows from: ", _sizes(v for v in prospect.causes if v.shows))
    out += _wrapped(
        "only if larger: ", _sizes(v for v in prospect.causes if not v.shows)
    )
    for group in prospect.groups:
        out += _wrapped("cannot separate: ", ", ".join(group.causes))
    reasons: dict[str, list[str]] = {}
    for entry in prospect.not_judged:
        reasons.setdefault(entry.reason.partition(":")[0], []).append(entry.cause)
    for reason, causes in reasons.items():
        out += _wrapped("not judged: ", f"{', '.join(causes)} ({reason})")
    return out


def _sizes(found: Iterable[Visible]) -> str:
    return ", ".join(f"{v.cause} {number(v.size, v.unit, digits=2)}" for v in found)


def _counted(names: Iterable[str]) -> list[str]:
    names = list(names)
    return [
        f"{n} x {name}" if (n := names.count(name)) > 1 else name
        for name in dict.fromkeys(names)
    ]


def _wrapped(head: str, text: str) -> list[str]:
    if not text:
        return []
    return textwrap.wrap(
        head + text,
        WIDTH,
        initial_indent="  ",
        subsequent_indent="    ",
        break_on_hyphens=False,
    )
