"""Plots as a separate SVG file: with title, legend and the colours for light and dark."""

from collections.abc import Sequence
from html import escape
from importlib.resources import files
from typing import Final

from hilserver.diagnosis.report.svg import MARGIN_LEFT, Plot

HEAD_HEIGHT: Final = 66.0  # where the first plot begins, below title and legend
_TITLE_Y, _LEGEND_Y = 24.0, 50.0
_SAMPLE, _GAP, _LETTER = 28.0, 22.0, 6.5


def document(
    plots: Sequence[Plot], title: str, legend: Sequence[tuple[str, str]]
) -> str:
    """Return plots, one below the other, as a file.

    Parameters
    ----------
    plots : sequence of Plot
        The first begins at `HEAD_HEIGHT`.
    legend : sequence of (str, str)
        Roles of lines, and their labels.
    """
    style = (
        files("hilserver.diagnosis.report")
        .joinpath("plot.css")
        .read_text(encoding="utf-8")
    )
    width = max(plot.width for plot in plots)
    height = max(plot.top + plot.height for plot in plots)
    inner = "".join(plot.render() for plot in plots)
    return (
        '<svg class="alone" xmlns="http://www.w3.org/2000/svg"'
        f' viewBox="0 0 {width:g} {height:g}" width="{width:g}" height="{height:g}"'
        f' role="img" aria-label="{escape(title)}">\n'
        f"<style>\n{style}</style>\n"
        f'<rect class="card" width="{width:g}" height="{height:g}" rx="8"/>\n'
        f'<text class="heading" x="{MARGIN_LEFT:g}" y="{_TITLE_Y:g}">{escape(title)}</text>\n'
        f"{_legend(legend)}\n{inner}\n</svg>\n"
    )


def _legend(entries: Sequence[tuple[str, str]]) -> str:
    parts, x = [], MARGIN_LEFT
    for role, text in entries:
        parts.append(
            f'<path class="line {role}" d="M{x:.0f} {_LEGEND_Y - 4:g}h{_SAMPLE:g}"/>'
            f'<text x="{x + _SAMPLE + 8:.0f}" y="{_LEGEND_Y:g}">{escape(text)}</text>'
        )
        x += _SAMPLE + 8 + _LETTER * len(text) + _GAP
    return "".join(parts)
