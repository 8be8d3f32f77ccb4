"""Figures of a sweep's report: distributions of margins, what decides, where it fails."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array
from hilserver.diagnosis.report.svg import Figure, Plot, picture, span_of
from hilserver.sweep.estimates import Influence
from hilserver.sweep.table import MachineTable

MOST_BARS: Final = 40
MOST_DOTS: Final = 1500
"""Most dots in a map; of more machines, failing ones are drawn first."""


def unit_text(unit: str) -> str:
    """Return a unit in brackets, nothing without one."""
    return f" [{unit}]" if unit not in ("", "1") else ""


def distribution(name: str, margins: Array, unit: str) -> Figure | None:
    """Draw how the margins of a requirement are distributed, failing ones in their own colour."""
    finite = margins[np.isfinite(margins)]
    endless = int(np.isneginf(margins).sum())
    if len(finite) < 2:
        return None
    low, high = span_of(finite, np.zeros(1))
    # One edge is at zero, so that no bar mixes passing and failing machines.
    wanted = max(int(2 * len(finite) ** (1 / 3)), 8)
    width = (high - low) / min(MOST_BARS, wanted)
    first = np.floor(low / width)
    last = np.ceil(high / width) + 1
    edges = np.arange(first, last) * width
    counts, _ = np.histogram(finite, edges)
    x_span = (float(edges[0]), float(edges[-1]))
    y_span = (0.0, float(counts.max()) * 1.06)
    plot = Plot(
        x=x_span,
        y=y_span,
        x_label=f"margin{unit_text(unit)}",
        y_label="machines",
        height=250.0,
    )
    for count, a, b in zip(counts.tolist(), edges[:-1], edges[1:], strict=True):
        if count:
            role = "passes" if a + b > 0.0 else "fails"
            plot.bar(
                float(a), float(b), count, role, f"{count} machines: {a:.4g} .. {b:.4g}"
            )
    plot.upright(0.0)
    failing = int((margins < 0.0).sum())
    if endless:
        beside = f" {endless} have none: drive too short, or value not a number."
    else:
        beside = ""
    caption = f"{failing} of {int((~np.isnan(margins)).sum())} machines fail.{beside}"
    return Figure(picture([plot], f"margins of {name}"), name, caption)


def failing_region(
    table: MachineTable, name: str, found: Sequence[Influence], units: dict[str, str]
) -> Figure | None:
    """Draw where machines fail, in the plane of the two most decisive parameters."""
    margins = table.margins[name]
    driven = np.flatnonzero(~np.isnan(margins))
    # A fault is present or not: it makes no axis.
    axes = [item.names[0] for item in found if item.names[0] in table.parameters]
    if len(axes) < 2 or not (margins[driven] < 0.0).any():
        return None
    first, second = axes[:2]
    x = table.parameters[first]
    y = table.parameters[second]
    x_label = first + unit_text(units[first])
    y_label = second + unit_text(units[second])
    plot = Plot(
        x=span_of(x[driven]),
        y=span_of(y[driven]),
        x_label=x_label,
        y_label=y_label,
        height=340.0,
    )
    _shares(plot, x[driven], y[driven], margins[driven] < 0.0)
    step = max(len(driven) // MOST_DOTS, 1)
    for fails, role in ((False, "passes"), (True, "fails")):
        rows = driven[(margins[driven] < 0.0) == fails][::step]
        titles = [f"machine {table.index[r]}: margin {margins[r]:.4g}" for r in rows]
        plot.dots(x[rows], y[rows], f"small {role}", titles)
    caption = (
        "Each dot is a machine; orange ones fail. Background: share of failures there, the"
        " darker the larger."
    )
    return Figure(
        picture([plot], f"where {name} fails"), f"Where '{name}' fails", caption
    )


def _shares(plot: Plot, x: Array, y: Array, fails: NDArray[np.bool_]) -> None:
    """Shade a grid of cells by the share of failing machines in each."""
    n = int(min(max(np.sqrt(len(x) / 8.0), 3), 16))
    x_edges = np.linspace(*plot.x, n + 1)
    y_edges = np.linspace(*plot.y, n + 1)
    total, _, _ = np.histogram2d(x, y, (x_edges, y_edges))
    failed, _, _ = np.histogram2d(x[fails], y[fails], (x_edges, y_edges))
    for i, j in zip(*np.nonzero(failed), strict=True):
        share = failed[i, j] / (total[i, j] + 1.0)  # one machine alone says little
        x_cell = (x_edges[i], x_edges[i + 1])
        y_cell = (y_edges[j], y_edges[j + 1])
        plot.cell(
            x_cell,
            y_cell,
            "fails",
            0.5 * share,
        )
