"""Plots as SVG text: axes, lines, bands, points. Classes name roles, the style has the colours."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from html import escape
from itertools import pairwise
from typing import Final

import numpy as np
from markupsafe import Markup

from hilserver.arrays import Array, Indices
from hilserver.diagnosis.findings.explain import MINUS, power_of_ten

MARGIN_LEFT: Final = 68.0
MARGIN_RIGHT: Final = 14.0
MARGIN_TOP: Final = 14.0
MARGIN_BOTTOM: Final = 44.0
LINE_POINTS: Final = 700  # points of one line; more are drawn as the extremes of pieces
MAX_RUNS: Final = 400  # runs of one line; of more, only every second or third is drawn
FEWEST_POINTS: Final = 4  # points of a run, however many runs there are


@dataclass(frozen=True, slots=True)
class Scale:
    """From values to positions in the picture, linear or logarithmic."""

    low: float
    high: float
    first: float
    last: float
    is_log: bool = False

    def __call__(self, values: Array | float) -> Array:
        """Return the position of each value."""
        x = np.asarray(values, dtype=np.float64)
        low, high = self.low, self.high
        if self.is_log:
            with np.errstate(divide="ignore", invalid="ignore"):
                x, low, high = np.log10(x), math.log10(low), math.log10(high)
        return self.first + (x - low) / (high - low) * (self.last - self.first)

    def ticks(self, wanted: int = 6) -> list[float]:
        """Return round values within the scale."""
        if self.is_log:
            return self._log_ticks()
        span = self.high - self.low
        step = 10.0 ** math.floor(math.log10(span / wanted))
        step *= next(f for f in (1, 2, 5, 10) if span / (f * step) <= wanted)
        first = math.ceil(self.low / step - 1e-9)
        end = math.floor(self.high / step + 1e-9)
        return [k * step for k in range(first, end + 1)]

    def _log_ticks(self) -> list[float]:
        decades = range(
            math.floor(math.log10(self.low)), math.ceil(math.log10(self.high)) + 1
        )
        all_ticks = [f * 10.0**d for d in decades for f in (1, 2, 5)]
        inside = [
            t
            for t in all_ticks
            if self.low <= t * (1 + 1e-9) and t <= self.high * (1 + 1e-9)
        ]
        if len(inside) <= 8:
            return inside
        return [t for t in inside if abs(math.log10(t) - round(math.log10(t))) < 1e-9]


def span_of(*arrays: Array | None, margin: float = 0.06) -> tuple[float, float]:
    """Return the range of all finite values, widened by a margin."""
    parts = [np.ravel(a) for a in arrays if a is not None and np.size(a)]
    values = np.concatenate(parts) if parts else np.zeros(1)
    values = values[np.isfinite(values)]
    if not len(values):
        return -1.0, 1.0
    low, high = float(values.min()), float(values.max())
    width = max(high - low, 1e-9, 1e-6 * max(abs(low), abs(high)))
    middle = 0.5 * (low + high)
    half = width * (0.5 + margin)
    return middle - half, middle + half


def label(value: float) -> str:
    """Return a tick's text."""
    if abs(value) < 1e-12:
        return "0"
    if 1e-3 <= abs(value) < 1e5:
        return f"{value:.6g}".replace("-", MINUS)
    power = math.floor(math.log10(abs(value)) + 1e-9)
    factor = value / 10.0**power
    text = "" if abs(factor - 1) < 1e-6 else f"{factor:.3g}·"
    return text.replace("-", MINUS) + power_of_ten(power)


def decimate(x: Array, y: Array, n: int = LINE_POINTS) -> tuple[Array, Array]:
    """Return at most `n` points that keep the smallest and largest value of every piece."""
    if len(x) <= n:
        return x, y
    length, longer = divmod(len(x), n // 2)
    edge = longer * (length + 1)  # the first pieces are longer by one
    first, rest = _extremes(y[:edge], length + 1), _extremes(y[edge:], length)
    kept = np.concatenate([first, rest + edge])
    return x[kept], y[kept]


def _extremes(y: Array, length: int) -> Indices:
    """Return the extremes of pieces of one length; if all are NaN, the beginning of the piece."""
    pieces = y.reshape(-1, length)
    blank = np.isnan(pieces)
    least, most = (
        np.argmin(np.where(blank, np.inf, sign * pieces), axis=1)
        for sign in (1.0, -1.0)
    )
    ends = np.sort(np.stack([least, most], axis=1), axis=1)
    ends[~np.isfinite(pieces).any(axis=1)] = 0
    differ = np.stack([np.ones(len(ends), dtype=bool), ends[:, 0] < ends[:, 1]], axis=1)
    return np.asarray((ends + length * np.arange(len(ends))[:, None])[differ])


def runs_of(run: Indices) -> list[slice]:
    """Return where the runs of a line are: at least one."""
    return [
        slice(a, b)
        for a, b in pairwise([0, *(np.flatnonzero(np.diff(run)) + 1), len(run)])
    ]


def thinned(x: Array, y: Array, run: Indices) -> tuple[Array, Array]:
    """Return the points of a line that breaks (at a NaN) wherever another run begins."""
    runs = runs_of(run)
    drawn = runs[:: math.ceil(len(runs) / MAX_RUNS)]
    most = max(FEWEST_POINTS, LINE_POINTS // len(drawn))
    parts = [decimate(x[own], y[own], most) for own in drawn]
    xs, ys = zip(
        *((np.append(a, np.nan), np.append(b, np.nan)) for a, b in parts), strict=True
    )
    return np.concatenate(xs), np.concatenate(ys)


def path_data(x: Array, y: Array) -> str:
    """Return the ``d`` of a line through the points; it breaks at points that are not finite."""
    parts, pen = [], "M"
    for px, py in zip(x.tolist(), y.tolist(), strict=True):
        if not (math.isfinite(px) and math.isfinite(py)):
            pen = "M"
            continue
        parts.append(f"{pen}{px:.1f} {py:.1f}")
        pen = "L"
    return "".join(parts)


@dataclass
class Plot:
    """One pair of axes and what is drawn between them."""

    # ranges of the values
    x: tuple[float, float]
    y: tuple[float, float]
    # with the unit
    x_label: str
    y_label: str
    width: float = 520.0
    height: float = 300.0
    top: float = 0.0  # where the plot begins in a picture of several plots
    log_x: bool = False
    log_y: bool = False
    _drawn: list[str] = field(default_factory=list)

    @property
    def to_x(self) -> Scale:
        """Scale of the abscissa."""
        return Scale(*self.x, MARGIN_LEFT, self.width - MARGIN_RIGHT, self.log_x)

    @property
    def to_y(self) -> Scale:
        """Scale of the ordinate, upwards."""
        return Scale(
            *self.y,
            self.top + self.height - MARGIN_BOTTOM,
            self.top + MARGIN_TOP,
            self.log_y,
        )

    def line(
        self,
        x: Array,
        y: Array,
        role: str,
        title: str,
        *,
        points: int = LINE_POINTS,
        run: Indices | None = None,
    ) -> None:
        """Draw a line; `role` is its class, `title` appears when the pointer rests on it.

        Parameters
        ----------
        run : ndarray of int64, optional
            The line breaks where this changes; shape as `x`.
        """
        kept = decimate(x, y, points) if run is None else thinned(x, y, run)
        self._line(*kept, role, title)

    def track(
        self,
        xy: Array,
        role: str,
        title: str,
        *,
        points: int = LINE_POINTS,
        begins: Sequence[int] = (),
    ) -> None:
        """Draw a path in the plane, shape (n, 2): every k-th point; it breaks at `begins`."""
        step = max(1, math.ceil(len(xy) / points))
        gap = np.full((1, 2), np.nan)
        parts = [
            np.vstack([own[::step], own[-1:], gap]) for own in np.split(xy, begins)
        ]
        x, y = np.concatenate(parts).T
        self._line(x, y, role, title)

    def _line(self, x: Array, y: Array, role: str, title: str) -> None:
        if data := path_data(*self._place(x, y)):
            text = f"<title>{escape(title)}</title>"
            self._drawn.append(f'<path class="line {role}" d="{data}">{text}</path>')

    def band(self, x: Array, low: Array, high: Array, role: str) -> None:
        """Fill between two lines."""
        xs, lows = self._place(x, low)
        _, highs = self._place(x, high)
        data = path_data(
            np.concatenate([xs, xs[::-1]]), np.concatenate([lows, highs[::-1]])
        )
        self._drawn.append(f'<path class="band {role}" d="{data}Z"/>')

    def dots(self, x: Array, y: Array, role: str, titles: Sequence[str]) -> None:
        """Draw points, each with its title."""
        for px, py, title in zip(*self._place(x, y), titles, strict=True):
            if math.isfinite(px) and math.isfinite(py):
                self._drawn.append(
                    f'<circle class="dot {role}" cx="{px:.1f}" cy="{py:.1f}" r="4">'
                    f"<title>{escape(title)}</title></circle>"
                )

    def whiskers(self, x: Array, low: Array, high: Array, role: str) -> None:
        """Draw an interval at each position."""
        xs, lows = self._place(x, low)
        _, highs = self._place(x, high)
        data = "".join(
            f"M{px:.1f} {a:.1f}V{b:.1f}"
            for px, a, b in zip(xs, lows, highs, strict=True)
            if math.isfinite(a) and math.isfinite(b)
        )
        if data:
            self._drawn.append(f'<path class="whisker {role}" d="{data}"/>')

    def bar(
        self, first: float, last: float, height: float, role: str, title: str
    ) -> None:
        """Fill a bar from zero upwards between two positions."""
        a, b = (float(self.to_x(v)) for v in (first, last))
        y0, y1 = (float(self.to_y(v)) for v in (0.0, height))
        self._drawn.append(
            f'<path class="bar {role}"'
            f' d="M{a + 0.5:.1f} {y0:.1f}V{y1:.1f}H{b - 0.5:.1f}V{y0:.1f}Z">'
            f"<title>{escape(title)}</title></path>"
        )

    def cell(
        self, x: tuple[float, float], y: tuple[float, float], role: str, opacity: float
    ) -> None:
        """Fill a rectangle."""
        (a, b), (low, high) = self.to_x(np.array(x)), self.to_y(np.array(y))
        self._drawn.append(
            f'<path class="area {role}" style="opacity:{opacity:.2f}"'
            f' d="M{a:.1f} {low:.1f}V{high:.1f}H{b:.1f}V{low:.1f}Z"/>'
        )

    def upright(self, x: float) -> None:
        """Draw a vertical reference line."""
        at, y0, y1 = (
            float(self.to_x(x)),
            self.top + self.height - MARGIN_BOTTOM,
            self.top,
        )
        self._drawn.append(f'<path class="axis" d="M{at:.1f} {y0}V{y1 + MARGIN_TOP}"/>')

    def begins(self, x: Array) -> None:
        """Mark at the upper edge where something begins anew."""
        y = self.top + MARGIN_TOP
        data = "".join(f"M{at:.1f} {y:g}v-7" for at in self.to_x(x))
        self._drawn.append(f'<path class="begin" d="{data}"/>')

    def level(self, y: float, text: str = "") -> None:
        """Draw a horizontal reference line with a word at its right end."""
        if not self.y[0] <= y <= self.y[1]:
            return
        at = float(self.to_y(y))
        x0, x1 = MARGIN_LEFT, self.width - MARGIN_RIGHT
        self._drawn.append(f'<path class="level" d="M{x0} {at:.1f}H{x1}"/>')
        if text:
            self._drawn.append(
                f'<text class="note" x="{x1 - 4}" y="{at - 5:.1f}" text-anchor="end">'
                f"{escape(text)}</text>"
            )

    def _place(self, x: Array, y: Array) -> tuple[Array, Array]:
        return self.to_x(x), np.clip(self.to_y(y), -1e4, 1e4)

    def _axes(self) -> str:
        x0, x1 = MARGIN_LEFT, self.width - MARGIN_RIGHT
        y0, y1 = self.top + self.height - MARGIN_BOTTOM, self.top + MARGIN_TOP
        parts = []
        for value in self.to_y.ticks(5):
            at = float(self.to_y(value))
            parts.append(
                f'<path class="grid" d="M{x0} {at:.1f}H{x1}"/>'
                f'<text class="tick" x="{x0 - 8}" y="{at + 4:.1f}" text-anchor="end">'
                f"{label(value)}</text>"
            )
        for value in self.to_x.ticks(7):
            at = float(self.to_x(value))
            parts.append(
                f'<path class="grid" d="M{at:.1f} {y0}V{y1}"/>'
                f'<text class="tick" x="{at:.1f}" y="{y0 + 17}" text-anchor="middle">'
                f"{label(value)}</text>"
            )
        middle_x, middle_y = (x0 + x1) / 2, (y0 + y1) / 2
        parts.append(
            f'<path class="axis" d="M{x0} {y0}H{x1}"/>'
            f'<text class="axis-label" x="{middle_x}" y="{y0 + 36}" text-anchor="middle">'
            f"{escape(self.x_label)}</text>"
            f'<text class="axis-label" transform="translate(13 {middle_y}) rotate(-90)"'
            f' text-anchor="middle">{escape(self.y_label)}</text>'
        )
        return "".join(parts)

    def render(self) -> str:
        """Return axes and content as a group."""
        return f"<g>{self._axes()}{''.join(self._drawn)}</g>"


@dataclass(frozen=True, slots=True)
class Figure:
    """A drawing with its title above and a sentence below; `legend`: roles and their labels."""

    svg: Markup
    title: str
    caption: str
    wide: bool = False
    legend: tuple[tuple[str, str], ...] = ()


def picture(plots: Sequence[Plot], name: str) -> Markup:
    """Return plots, one below the other, as one SVG element; `name` is for screen readers."""
    width = max(plot.width for plot in plots)
    height = max(plot.top + plot.height for plot in plots)
    inner = "".join(plot.render() for plot in plots)
    return Markup(  # noqa: S704 - texts are escaped where they are drawn
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(name)}">'
        f"{inner}</svg>"
    )
