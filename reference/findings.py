"""The page of findings, made from the vocabulary and its sentences."""

from pathlib import Path

from jinja2 import Template

from hilserver.diagnosis.catalogue.vocabulary import CAUSES, Cause
from hilserver.diagnosis.findings.explain import experiments, sentences


def as_markdown() -> str:
    """Return the reference as Markdown."""
    rows = [_row(cause) for cause in CAUSES.values()]
    pairs = [
        f"| {', '.join(f'`{name}`' for name in sorted(causes))} | {text} |"
        for causes, text in experiments().items()
    ]
    page = Path(__file__).with_suffix(".md.j2").read_text(encoding="utf-8")
    template = Template(page, keep_trailing_newline=True)
    text: str = template.render(causes="\n".join(rows), experiments="\n".join(pairs))
    return text


def _row(cause: Cause) -> str:
    parts = [part.name.removeprefix(f"{cause.name}.") for part in cause.parts]
    named = "per signal or source" if cause.by_channel else ", ".join(parts)
    shown = named if len(parts) > 1 or cause.by_channel else ""
    units = ", ".join(dict.fromkeys(part.unit for part in cause.parts))
    nulls = ", ".join(
        "none" if p.null is None else f"{p.null:g}" for p in cause.parts if not p.shape
    )
    remedy = sentences()[cause.name]["remedy"]
    return (
        f"| `{cause.name}` | {shown} | {units} | {nulls} | {cause.block} | {remedy} |"
    )
