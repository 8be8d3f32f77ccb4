"""The plots of channels over time: values above, residuals below."""

import math

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.findings.explain import number
from hilserver.diagnosis.report.plain import plain
from hilserver.diagnosis.report.svg import (
    MAX_RUNS,
    Figure,
    Plot,
    picture,
    runs_of,
    span_of,
)
from hilserver.diagnosis.schema.evidence import ChannelSeries

MAX_MARKS = 60  # run beginnings that are marked; more of them would merge into a bar


def series(item: ChannelSeries) -> Figure:
    """Draw one channel, and below it its residual before and after."""
    t = _continuous(item.t_s, item.run)
    before = item.measured - item.simulated
    after = None if item.extended is None else item.measured - item.extended
    x, models = span_of(t, margin=0.0), (item.measured, item.simulated, item.extended)
    values = Plot(x, span_of(*models), "", f"value [{item.unit}]", height=230)
    residual = Plot(
        x,
        span_of(before, after),
        "time [s]",
        f"residual [{item.unit}]",
        height=190,
        top=206,
    )
    residual.level(0.0)
    for plot, role, y, title in (
        (values, "measured", item.measured, f"{item.name} measured"),
        (values, "simulated", item.simulated, f"{item.name} simulated"),
        (values, "extended", item.extended, f"{item.name} extended"),
        (residual, "before", before, "measured minus simulated"),
        (residual, "after", after, "measured minus extended"),
    ):
        if y is not None:
            plot.line(t, y, role, title, run=item.run)
    begins = np.array([edge.start for edge in runs_of(item.run)][1:], dtype=np.int64)
    if 0 < len(begins) <= MAX_MARKS:
        values.begins(t[begins])
    text = f"Mean absolute residual {_mean(before, item.unit)}"
    if after is not None:
        text += f" before, {_mean(after, item.unit)} after"
    return Figure(
        picture([values, residual], f"{item.name} over time"),
        plain(item.name),
        f"{text}.{_anew(len(begins))}",
    )


def _anew(begins: int) -> str:
    """Say where the models begin anew, and what is not drawn."""
    if not begins:
        return ""
    text = f" The models restart {begins} time{'s' * (begins > 1)}"
    text += (
        ", at the marks at the top."
        if begins <= MAX_MARKS
        else ", where the lines break."
    )
    step = math.ceil((begins + 1) / MAX_RUNS)
    return f"{text} Only one run in {step} is drawn." if step > 1 else text


def improvement(item: ChannelSeries) -> float:
    """Return the mean absolute residual before over that after; 1 without an extension."""
    if item.extended is None:
        return 1.0
    models = (item.simulated, item.extended)
    before, after = (
        float(np.nanmean(np.abs(item.measured - model))) for model in models
    )
    return before / after if after > 0 else math.inf


def _continuous(t_s: Array, run: Indices) -> Array:
    """Place runs whose times overlap one after the other."""
    t, end = t_s.copy(), -math.inf
    for edge in runs_of(run):
        if len(t[edge]) and t[edge][0] < end:
            t[edge] += end - t[edge][0]
        end = float(t[edge][-1]) if len(t[edge]) else end
    return t


def _mean(residual: Array, unit: str) -> str:
    return number(float(np.nanmean(np.abs(residual))), unit, digits=2)
