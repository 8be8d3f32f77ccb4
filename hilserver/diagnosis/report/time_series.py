"""The plots of channels over time: values above, residuals below."""

import math
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.findings.explain import number
from hilserver.diagnosis.report.plain import plain
from hilserver.diagnosis.report.svg import MAX_POINTS, Figure, Plot, picture, span_of
from hilserver.diagnosis.schema.evidence import Array, Series

MAX_SPANS = 60


def series(item: Series) -> Figure:
    """Draw one channel above its residual before and after."""
    t = _continuous(item.t_s, item.span)
    edges = _edges(item.span)
    values = Plot(
        span_of(t, margin=0.0),
        span_of(item.measured, item.simulated, item.extended),
        "",
        f"{_short(item.name)} [{item.unit}]",
        height=230,
    )
    before = item.measured - item.simulated
    after = None if item.extended is None else item.measured - item.extended
    residual = Plot(
        values.x, span_of(before, after), "time [s]", f"residual [{item.unit}]", height=190, top=206
    )
    for role, y in (
        ("measured", item.measured),
        ("simulated", item.simulated),
        ("extended", item.extended),
    ):
        _lines(values, t, y, edges, role, f"{item.name} {role}")
    for edge in _held_out(item):
        residual.stretch(float(t[edge.start]), float(t[edge.stop - 1]), "held")
    residual.level(0.0)
    _lines(residual, t, before, edges, "before", "measured minus simulated")
    _lines(residual, t, after, edges, "after", "measured minus extended")
    text = f"Mean absolute residual {_mean(before, item.unit)}"
    if after is not None:
        text += f" before, {_mean(after, item.unit)} after"
    if item.held_out is not None:
        text += "; shaded: took no part in the fit"
    return Figure(
        picture([values, residual], f"{item.name} over time"), plain(item.name), f"{text}."
    )


def improvement(item: Series) -> float:
    """Return the mean absolute residual before by that after; 1 without an extension."""
    if item.extended is None:
        return 1.0
    models = (item.simulated, item.extended)
    before, after = (float(np.nanmean(np.abs(item.measured - model))) for model in models)
    return before / after if after > 0 else math.inf


def _lines(
    plot: Plot, t: Array, y: Array | None, edges: list[slice], role: str, title: str
) -> None:
    if y is None:
        return
    points = max(8, MAX_POINTS // max(1, len(edges)))
    for edge in edges:
        plot.line(t[edge], y[edge], role, title, points=points)


def _edges(span: NDArray[np.int64]) -> list[slice]:
    starts = [0, *(np.flatnonzero(np.diff(span)) + 1).tolist(), len(span)]
    return [slice(a, b) for a, b in pairwise(starts)][:MAX_SPANS]


def _held_out(item: Series) -> list[slice]:
    if item.held_out is None:
        return []
    runs = _edges(item.held_out.astype(np.int64))
    return [run for run in runs if item.held_out[run.start]]


def _continuous(t_s: Array, span: NDArray[np.int64]) -> Array:
    """Put segments whose times overlap one after the other."""
    t, end = t_s.copy(), -math.inf
    for edge in _edges(span):
        if len(t[edge]) and t[edge][0] < end:
            t[edge] += end - t[edge][0]
        end = float(t[edge][-1]) if len(t[edge]) else end
    return t


def _mean(residual: Array, unit: str) -> str:
    return number(float(np.nanmean(np.abs(residual))), unit, digits=2)


def _short(name: str) -> str:
    return name.rpartition("_")[0].replace("_", " ") or name
