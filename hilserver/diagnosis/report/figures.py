"""The plots of a report, from the evidence; channels over time are in `time_series`."""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from markupsafe import Markup

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.vocabulary import known_part
from hilserver.diagnosis.findings.explain import QUANTITIES, number
from hilserver.diagnosis.report.plain import plain
from hilserver.diagnosis.report.svg import (
    MARGIN_BOTTOM,
    MARGIN_LEFT,
    MARGIN_RIGHT,
    MARGIN_TOP,
    Figure,
    Plot,
    Scale,
    label,
    picture,
    span_of,
)
from hilserver.diagnosis.report.words import RatioInWords
from hilserver.diagnosis.schema.evidence import (
    Course,
    Dependence,
    HorizonRow,
    Path,
    Similarity,
)
from hilserver.diagnosis.schema.findings import Gain, Parameter

SMALLEST_LIKENESS = 0.5
MAX_LIKE = 22
INTERVAL_WIDTH = 260.0
INTERVAL_TICKS = 4
APART = 1.02  # distance of the lines in one plot, so that their intervals are legible


def path(way: Path) -> Figure:
    """Draw the path over the floor, to scale."""
    tracks = [t for t in (way.measured, way.simulated, way.extended) if t is not None]
    x, y = (span_of(*(t[:, i] for t in tracks), margin=0.05) for i in (0, 1))
    inner_w, inner_h = (
        520.0 - MARGIN_LEFT - MARGIN_RIGHT,
        400.0 - MARGIN_TOP - MARGIN_BOTTOM,
    )
    width, height = x[1] - x[0], y[1] - y[0]
    if width / inner_w > height / inner_h:
        y = _around(y, width * inner_h / inner_w)
    else:
        x = _around(x, height * inner_w / inner_h)
    plot = Plot(x, y, "x [m]", "y [m]", height=400)
    plot.track(way.measured, "measured", "measured")
    models = by_role(way.simulated, way.extended)
    for role, track in models:
        plot.track(track, role, role, begins=way.begins)
        starts = track[[0, *way.begins]]
        titles = [f"{role} begins"] * len(starts)
        plot.dots(starts[:, 0], starts[:, 1], f"begin {role}", titles)
    plot.dots(way.measured[:1, 0], way.measured[:1, 1], "start", ["start"])
    ends = ", ".join(
        f"{name} {number(float(np.hypot(*(track[-1] - way.measured[-1]))), 'm', digits=2)}"
        for name, track in models
    )
    rings = "Ring: start of a model run; the start pose is fitted."
    if way.begins:
        pieces = len(way.begins) + 1
        rings = f"Rings: starts of the {pieces} model runs; the start poses are fitted."
    title = (
        f"Path, {way.group}, segment {way.span}"
        if way.group
        else f"Path, segment {way.span}"
    )
    return Figure(
        picture([plot], title),
        title,
        f"Distance from the measured end: {ends}. {rings}",
    )


def by_role(simulated: Array, extended: Array | None) -> list[tuple[str, Array]]:
    """Return what the models do, by their role in a plot."""
    models = [("simulated", simulated)]
    return models if extended is None else [*models, ("extended", extended)]


def _around(span: tuple[float, float], width: float) -> tuple[float, float]:
    middle = 0.5 * (span[0] + span[1])
    return middle - width / 2, middle + width / 2


def horizons(rows: Sequence[HorizonRow]) -> Figure | None:
    """Draw the gain over the length of a free run, one line per quantity; None without any."""
    runs = [r for r in rows if math.isfinite(r.gain.ratio) and r.gain.ratio > 0]
    gains = [r.gain for r in runs]
    if all(RatioInWords.of(g).is_none for g in gains):
        return None
    length_s, ratios = (
        np.array([g.horizon_s for g in gains]),
        np.array([g.ratio for g in gains]),
    )
    ends = np.array(
        [e for g in gains for e in g.ci95 or () if math.isfinite(e) and e > 0]
    )
    low, high = (
        10.0**v for v in span_of(np.log10(ratios), np.log10(ends), np.zeros(1))
    )
    plot = Plot((length_s.min() / 1.25, length_s.max() * 1.25), (low, high), "free run [s]",
                "times better", width=720, height=320, log_x=True, log_y=True)  # fmt: skip
    plot.level(1.0, "as good as before")
    legend = []
    for place, (key, (name, unit)) in enumerate(QUANTITIES.items()):
        if own := [r.gain for r in runs if r.quantity == key]:
            legend.append((f"quantity q{place}", name))
            _gain_line(plot, own, f"quantity q{place}", name, unit, shift=APART**place)
    caption = "Error of the simulation divided by that of the extended model, on held-out parts."
    if any(g.ci95 is None for g in gains):
        caption += " Rings: too few runs for an interval."
    svg = picture([plot], "Gain over the length of the free run")
    return Figure(svg, "Gain", caption, wide=True, legend=tuple(legend))


def _gain_line(
    plot: Plot, gains: Sequence[Gain], role: str, name: str, unit: str, *, shift: float
) -> None:
    x, ratio = (
        shift * np.array([g.horizon_s for g in gains]),
        np.array([g.ratio for g in gains]),
    )
    low, high = np.array(
        [(math.nan, math.nan) if g.ci95 is None else g.ci95 for g in gains]
    ).T
    plot.line(x, ratio, role, f"{name}: ratio of errors")
    plot.whiskers(x, low, high, role)
    for at, value, g in zip(x, ratio, gains, strict=True):
        own = f"{role} ring" if g.ci95 is None else role
        errors = f"{number(g.before, unit)} to {number(g.after, unit)}"
        title = f"{name}, {number(g.horizon_s)} s: {errors}, {RatioInWords.of(g)}"
        plot.dots(at[None], value[None], own, [title])


def likeness(similarity: Similarity) -> Figure | None:
    """Draw which causes look alike in these data."""
    cosine = np.nan_to_num(similarity.cosine)
    others = np.abs(cosine - np.diag(np.diag(cosine)))
    strongest = others.max(axis=1)
    kept = np.flatnonzero(strongest >= SMALLEST_LIKENESS)
    kept = np.sort(kept[np.argsort(-strongest[kept], kind="stable")][:MAX_LIKE])
    if len(kept) < 2:
        return None
    names = [similarity.names[i] for i in kept]
    return Figure(
        _heat_map(names, cosine[np.ix_(kept, kept)], similarity.limit),
        "Causes that look alike in these data",
        "Full colour: the same effect (orange: with opposite sign). Framed: above"
        f" {similarity.limit:g}, these data cannot separate the two. Causes that resemble no"
        " other are left out.",
        wide=True,
    )


def _heat_map(names: Sequence[str], cosine: Array, limit: float) -> Markup:
    """Draw a square for each pair, framed if its |cos| is above the limit."""
    size, left, top = 22.0, 170.0, 6.0
    bottom = top + len(names) * size
    parts = []
    for r, name in enumerate(names):
        y, x = top + r * size, left + (r + 0.65) * size
        parts.append(
            f'<text class="tick" x="{left - 8}" y="{y + 15:.0f}" text-anchor="end">{name}</text>'
            f'<text class="tick" transform="translate({x:.0f} {bottom + 10:.0f}) rotate(-60)"'
            f' text-anchor="end">{name}</text>'
        )
        for c, other in enumerate(names):
            value = float(cosine[r, c])
            twin = "twin" if r != c and abs(value) > limit else ""
            minus = "minus" if value < 0 else ""
            parts.append(
                f'<rect class="cell {minus} {twin}" x="{left + c * size + 1:.0f}" y="{y + 1:.0f}"'
                f' width="{size - 2:.0f}" height="{size - 2:.0f}" rx="3"'
                f' fill-opacity="{abs(value) ** 2:.2f}"><title>{name} / {other}:'
                f" {label(round(value, 3))}</title></rect>"
            )
    width, height = left + len(names) * size + 10, bottom + 130
    return Markup(  # noqa: S704 - names of causes and numbers
        f'<svg style="width:{width:.0f}px" viewBox="0 0 {width:.0f} {height:.0f}" role="img"'
        f' aria-label="Similarity of causes">{"".join(parts)}</svg>'
    )


def dependence(item: Dependence) -> Figure:
    """Draw the remaining residual against one regressor."""
    name = f"{item.channel} over {item.regressor}"
    labels = (
        f"{item.regressor} [{item.regressor_unit}]",
        f"remaining error [{item.unit}]",
    )
    plot = Plot(
        span_of(item.x), span_of(item.low, item.high, np.zeros(1)), *labels, height=250
    )
    plot.level(0.0)
    plot.band(item.x, item.low, item.high, "extended")
    plot.line(item.x, item.mean, "extended", name)
    caption = f"Test statistic {number(item.statistic)}, critical value {number(item.critical)}."
    return Figure(picture([plot], name), plain(name), caption)


def course(item: Course) -> Figure:
    """Draw a parameter over time."""
    labels = "time [s]", f"{item.cause} [{item.unit}]"
    plot = Plot(span_of(item.t_s), span_of(item.low, item.high), *labels, height=250)
    plot.band(item.t_s, item.low, item.high, "extended")
    plot.line(item.t_s, item.value, "extended", item.cause)
    plot.dots(item.t_s, item.value, "extended",
              [number(float(v), item.unit) for v in item.value])  # fmt: skip
    svg = picture([plot], f"{item.cause} over time")
    return Figure(svg, item.cause, "Fitted in windows, with 95 % intervals.")


def paths(ways: Iterable[Path]) -> list[Figure]:
    """Draw the paths, in the order of their groups and segments."""
    return [path(way) for way in sorted(ways, key=lambda w: (w.group, w.span))]


def interval(parameter: Parameter, name: str) -> Markup:
    """Draw the value and interval of a parameter, and its null."""
    part = known_part(name)
    null = None if part is None else part.null
    if parameter.ci95 is None or null is None:
        return Markup("<span></span>")
    low, high = parameter.ci95
    left, right = min(low, null), max(high, null)
    margin = 0.12 * ((right - left) or 1.0)
    scale = Scale(left - margin, right + margin, 0, INTERVAL_WIDTH)
    a, b, at, zero = (
        f"{float(scale(v)):.1f}" for v in (low, high, parameter.value, null)
    )
    text = f"{name}: {number(low)} to {number(high)}; no effect: {number(null)}"
    ticks = Markup("").join(
        Markup(
            '<path class="axis" d="M{x} 20v4"/><text x="{x}" y="38">{text}</text>'
        ).format(x=f"{float(scale(value)):.1f}", text=label(value))
        for value in scale.ticks(INTERVAL_TICKS)
    )
    return Markup(
        '<svg viewBox="0 0 {width:g} 42" role="img" aria-label="{text}">'
        '<path class="axis" d="M0 20H{width:g}"/>{ticks}<path class="null" d="M{zero} 4V20"/>'
        '<path class="whisker" d="M{a} 12H{b}"/><circle class="dot" cx="{at}" cy="12" r="5"/>'
        "<title>{text}</title></svg>"
    ).format(width=INTERVAL_WIDTH, text=text, ticks=ticks, zero=zero, a=a, b=b, at=at)
