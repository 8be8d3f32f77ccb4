"""The sentences and the picture that 'hilserver observe' makes of a run of the filter."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array
from hilserver.diagnosis.report.standalone import HEAD_HEIGHT, document
from hilserver.diagnosis.report.svg import Plot, span_of
from hilserver.observer.correction import GATE_1, GATE_2
from hilserver.observer.layout import BIAS, YAW, Shown, X, Y
from hilserver.observer.log_noise import sd_of
from hilserver.observer.offline import POSITION, EstimatedCourse, MeasuredSeries
from hilserver.observer.offline import run as run_filter
from hilserver.plant.layout import Parameters

STATE: Final = Shown.where("state").start
DEVIATIONS: Final = Shown.where("deviations")
MOST_NIS: Final = 2.0
"""Squared innovations beside their covariance, above which the filter does not know the robot."""


@dataclass(frozen=True)
class Observed:
    """One segment: its measurements, and the estimate from them."""

    number: int
    series: MeasuredSeries
    course: EstimatedCourse
    # by the filter or the smoother
    estimate: Array
    covariance: Array

    @property
    def signals(self) -> Array:
        """The signals estimate.*, shape (n, Shown.n_words)."""
        out = self.course.shown.copy()
        m = self.covariance
        out[:, : BIAS + 1] = self.estimate[:, : BIAS + 1]
        out[:, YAW] = np.angle(np.exp(1j * self.estimate[:, YAW]))
        part = np.einsum("nii->ni", m)[:, : BIAS + 1]
        out[:, DEVIATIONS] = np.sqrt(np.maximum(part, 0.0))
        first = DEVIATIONS.stop
        rows = [m[:, X, Y], m[:, X, YAW], m[:, Y, YAW]]
        out[:, first : first + 3] = np.stack(rows, axis=1)
        return out

    @property
    def known(self) -> NDArray[np.bool_]:
        """Whether a pose is known, at each moment."""
        return np.asarray(self.course.shown[:, STATE] > 0.0)

    @property
    def places(self) -> Array:
        """Positions of the navigation: time, x, y; shape (n, 3)."""
        samples = self.series.samples
        return np.asarray(samples[samples[:, 0] == POSITION, 1:])

    def off(self, xy: Array) -> Array:
        """Return how far a path is from the navigation at its samples [m], shape (n,)."""
        t = self.series.wheels[:, 0]
        known = self.known
        if not known.any():
            return np.zeros(0)
        is_later = self.places[:, 0] >= t[known][0]
        places = self.places[is_later]
        at = [np.interp(places[:, 0], t, xy[:, k]) for k in (0, 1)]
        off_x_m = at[0] - places[:, 1]
        off_y_m = at[1] - places[:, 2]
        away: Array = np.hypot(off_x_m, off_y_m)
        return away


def dead_reckoning(p: Parameters, c: Array, one: Observed) -> Array:
    """Return the path by the wheels alone, from the first known pose; shape (n, 2)."""
    course = run_filter(p, c, MeasuredSeries(one.series.wheels, np.zeros((0, 4))))
    x = course.estimate
    first = int(np.argmax(one.known))
    turn = one.course.estimate[first, YAW] - x[first, YAW]
    cos = math.cos(turn)
    sin = math.sin(turn)
    away = x[:, :2] - x[first, :2]
    turned = np.array([[cos, sin], [-sin, cos]])
    path: Array = one.course.estimate[first, :2] + away @ turned
    return path


def mean_nis(courses: Sequence[EstimatedCourse]) -> float:
    """Return the mean of the squared innovations over their covariance; an outlier is its gate."""
    nis = np.concatenate([one.innovations for one in courses])
    capped = np.minimum(nis, (GATE_2 / 2.0, GATE_1))
    capped = capped[np.isfinite(capped)]
    return float(capped.mean()) if capped.size else 1.0


def doubts(times: float, *, inflates: bool) -> str:
    """Return that the filter was surer than it may be, by the mean NIS, and what to do."""
    said = f"The squared innovations are {times:.1f} times their covariance: "
    if inflates:
        return said + "all variances have been made that much larger (--inflate)."
    return (
        said + "the filter does not know this robot, and is less certain than it says."
        " 'hilserver diagnose' finds out why; --inflate makes all variances that much larger."
    )


def _of_noise(given: Array, c: Array) -> str:
    """Return the noise that was fitted, in words."""

    def both(name: str, unit: str = "") -> str:
        return f"{sd_of(c, name):.2g}{unit} ({sd_of(given, name):.2g})"

    parts = [
        f"position {both('position_sd', ' m')}",
        f"its correlated part {both('position_ou', ' m')}",
        f"heading {both('yaw_sd', ' rad')}",
        f"its correlated part {both('yaw_ou', ' rad')}",
        f"motion of a metre {both('roam', ' m')}",
        f"its heading {both('roam_yaw', ' rad')}",
        f"share of the speed {both('slip_sd')}",
        f"of the turn rate {both('gain_sd')}",
    ]
    return f"Standard deviations, fitted to this log (as given): {'; '.join(parts)}."


def sentences(p: Parameters, given: Array, c: Array, spans: Sequence[Observed]) -> str:
    """Return the result in words, one sentence per line.

    Parameters
    ----------
    given, c : ndarray
        Constants of the filter before and after the noise was fitted to the log.
    """
    known = [one for one in spans if one.known.any()]
    if not known:
        return (
            "No pose is known: the log has no navigation position with a heading (nav.x_m, nav.y_m,"
            " nav.yaw_rad); only speed and turn rate are estimated."
        )
    accepted, rejected, readmitted, doubted, late = (
        int(sum(one.course.head[name] for one in known))
        for name in ("accepted", "rejected", "readmitted", "doubted", "late")
    )
    lines = [
        f"{accepted} navigation samples were used and {rejected} rejected as outliers; the robot"
        f" was carried {readmitted} times, {doubted} times the pose was less certain than thought,"
        f" and {late} samples came too late.",
        _of_noise(given, c),
    ]
    nis = mean_nis([one.course for one in known])
    n = max(accepted, 1)
    half = 1.96 * math.sqrt(2.0 / (1.5 * n))
    fits = "as" if abs(nis - 1.0) <= half else "not what"
    lines.append(
        f"The squared innovations are {nis:.2f} times their covariance, {fits} expected"
        f" ({1.0 - half:.2f} to {1.0 + half:.2f})."
    )
    pieces = [one.signals[one.known][:, DEVIATIONS] for one in known]
    deviations = np.concatenate(pieces)
    place = np.hypot(deviations[:, 0], deviations[:, 1])
    lines.append(
        f"The median standard deviation is {np.median(place):.3f} m for the position and"
        f" {np.median(deviations[:, YAW]):.4f} rad for the heading."
    )
    if any(len(one.places) for one in known):
        distances = [one.off(one.estimate[:, :2]) for one in known]
        near = np.concatenate(distances)
        far = np.concatenate([one.off(dead_reckoning(p, c, one)) for one in known])
        lines.append(
            f"The path is {_rms(near):.3f} m (RMS) from the navigation positions; the path from the"
            f" wheels alone is {_rms(far):.3f} m from them."
        )
    return "\n".join(lines)


def _rms(values: Array) -> float:
    if values.size:
        return float(np.sqrt(np.mean(values * values)))
    return math.nan


def path_picture(p: Parameters, c: Array, spans: Sequence[Observed]) -> str:
    """Return the path as an SVG file: navigation, wheels alone, estimate."""
    known = [one for one in spans if one.known.any()] or list(spans)
    measured = [one.places[:, 1:] for one in known]
    simulated = [dead_reckoning(p, c, one)[one.known] for one in known]
    extended = [one.estimate[one.known, :2] for one in known]
    paths = [
        ("measured", measured),
        ("simulated", simulated),
        ("extended", extended),
    ]
    drawn = [xy for _, pieces in paths for xy in pieces]
    everything = np.concatenate([*drawn, np.zeros((1, 2))])
    x_span = span_of(everything[:, 0])
    y_span = span_of(everything[:, 1])
    plot = Plot(
        x_span,
        y_span,
        "x in m",
        "y in m",
        width=720.0,
        height=560.0,
        top=HEAD_HEIGHT,
    )
    titles = dict(LEGEND)
    for role, pieces in paths:
        totals = np.cumsum([0, *(len(xy) for xy in pieces)])
        begins = totals[:-1].tolist()
        xy = np.concatenate(pieces) if pieces else np.zeros((0, 2))
        if len(xy):
            plot.track(xy, role, titles[role], begins=begins)
    return document([plot], "Where the robot was", LEGEND)


LEGEND: Final = (
    ("measured", "navigation"),
    ("simulated", "wheels alone"),
    ("extended", "estimate"),
)
