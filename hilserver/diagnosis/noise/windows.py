"""Residuals cut into windows, each with a level and a slope, and their restricted likelihood."""

import math
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.compiled import kernel
from hilserver.diagnosis.noise.whitening import NoiseModel
from hilserver.diagnosis.thresholds import FAR_SD, NOISE_WINDOW_S

SAMPLES_MAX: Final = 12_000
_SAMPLES_MIN = 4  # in a window: level and slope are free
_TRIMMED = 0.75
_TRIMMED_MEAN_SQUARE = 0.3685  # of a normal variable's smallest 75 % (by size)


@dataclass
class NoiseWindows:
    """Samples of all windows, one after the other."""

    # shape (n,): stamps within the window (centred), residuals, and 1 or 0 for an outlier
    t_s: Array
    r: Array
    weights: Array
    starts: Indices  # shape (windows + 1,): index of each window's first sample, and n
    lines: Array  # shape (windows, 2): level and slope, robust

    @classmethod
    def cut(
        cls, residuals: Iterable[tuple[Array, Array]], window_s: float = NOISE_WINDOW_S
    ) -> "NoiseWindows":
        """Cut spans into equal windows; if there are too many, drop some evenly."""
        pieces: list[tuple[Array, Array]] = []
        for stamps, values in residuals:
            good = np.isfinite(values)
            t_s, r = np.asarray(stamps, float)[good], np.asarray(values, float)[good]
            if not len(t_s):
                continue
            count = max(1, math.ceil((t_s[-1] - t_s[0]) / window_s))
            edges = np.linspace(t_s[0], t_s[-1], count + 1)[1:-1]
            cuts = np.searchsorted(t_s, edges)
            pieces += zip(np.split(t_s, cuts), np.split(r, cuts), strict=True)
        pieces = [piece for piece in pieces if len(piece[0]) >= _SAMPLES_MIN]
        return cls._of(_evenly(pieces))

    @classmethod
    def _of(cls, pieces: list[tuple[Array, Array]]) -> "NoiseWindows":
        if not pieces:
            none = np.zeros(0)
            return cls(none, none, none, np.zeros(1, np.int64), np.zeros((0, 2)))
        t_s = np.concatenate([t - t.mean() for t, _ in pieces])
        starts = np.cumsum([0, *(len(t) for t, _ in pieces)]).astype(np.int64)
        r = np.concatenate([r for _, r in pieces])
        lines = np.zeros((len(pieces), 2))
        robust_lines(t_s, r, starts, lines)
        return cls(t_s, r, np.ones(len(r)), starts, lines)

    @property
    def samples(self) -> int:
        """Number of samples."""
        return len(self.r)

    @property
    def step_s(self) -> float:
        """Median time between two samples."""
        return max(float(np.median(np.diff(self.t_s)[np.diff(self.t_s) > 0.0])), 1e-6)

    @cached_property
    def spread(self) -> float:
        """Robust standard deviation about the windows' lines."""
        return _robust_sd(self._detrended())

    @cached_property
    def level_sd(self) -> float:
        """Robust standard deviation of the residuals themselves."""
        return max(_robust_sd(self.r - float(np.median(self.r))), self.spread)

    def thinned(self, samples_max: int) -> "NoiseWindows":
        """Return some of the windows, chosen evenly, with their weights."""
        count = len(self.starts) - 1
        wanted = max(1, min(count, count * samples_max // max(self.samples, 1)))
        chosen = np.unique(np.linspace(0, count - 1, wanted).round().astype(int))
        rows = [np.arange(self.starts[i], self.starts[i + 1]) for i in chosen]
        index = np.concatenate(rows)
        starts = np.cumsum([0, *(len(row) for row in rows)]).astype(np.int64)
        return NoiseWindows(
            self.t_s[index],
            self.r[index],
            self.weights[index],
            starts,
            self.lines[chosen],
        )

    def gate_level(self) -> None:
        """Leave out samples far from their window's line."""
        self.weights = (np.abs(self._detrended()) <= 2.0 * FAR_SD * self.spread).astype(
            float
        )

    def gate_innovations(self, model: NoiseModel) -> float:
        """Leave out samples whose innovation is too large; return their share."""
        self._innovations(model, FAR_SD, weights := np.ones(self.samples))
        self.weights = weights
        return 1.0 - float(weights.mean())

    def innovations(self, model: NoiseModel) -> Array:
        """Return the whitened residuals about the windows' lines; 0 where left out."""
        return self._innovations(model, math.inf, self.weights.copy())

    def likelihood(self, white: float, ou: float, tau_s: float) -> tuple[float, float]:
        """Return the restricted log likelihood at the best scale, and that scale.

        `white` and `ou` are variances up to the scale; level and slope are marginalised.
        """
        square, log_det, free = restricted(
            self.t_s, self.r, self.weights, self.starts, white, ou, tau_s, self.lines
        )
        if free < 1.0:
            return -math.inf, 1e-12
        variance = max(square / free, 1e-300)
        return -0.5 * (log_det + free * (math.log(variance) + 1.0)), math.sqrt(variance)

    def _detrended(self) -> Array:
        owner = np.repeat(np.arange(len(self.lines)), np.diff(self.starts))
        rest: Array = self.r - self.lines[owner, 0] - self.lines[owner, 1] * self.t_s
        return rest

    def _innovations(self, model: NoiseModel, gate_sd: float, weights: Array) -> Array:
        out = np.zeros(self.samples)
        variances = (model.white_sd**2, model.ou_sd**2, model.ou_tau_s)
        gated(
            self.t_s, self._detrended(), self.starts, *variances, gate_sd, weights, out
        )
        return out


def _evenly(pieces: list[tuple[Array, Array]]) -> list[tuple[Array, Array]]:
    total = sum(len(t) for t, _ in pieces)
    if total <= SAMPLES_MAX:
        return pieces
    wanted = max(1, len(pieces) * SAMPLES_MAX // total)
    chosen = np.unique(np.linspace(0, len(pieces) - 1, wanted).round().astype(int))
    return [pieces[i] for i in chosen]


def _robust_sd(values: Array) -> float:
    """Return the trimmed standard deviation, or the plain one if nine tenths are equal."""
    square = np.sort(np.square(values))
    kept = square[: max(1, int(_TRIMMED * len(square)))]
    trimmed = math.sqrt(float(kept.mean()) / _TRIMMED_MEAN_SQUARE)
    return trimmed if trimmed > 0.0 else math.sqrt(float(square.mean()))


@kernel()
def robust_lines(t_s: Any, r: Any, starts: Any, lines: Any) -> None:
    """Fit a line of least absolute deviation to every window (reweighted least squares)."""
    for k in range(len(starts) - 1):
        first, end = starts[k], starts[k + 1]
        level, slope = np.median(r[first:end]), 0.0
        small = 1e-3 * np.mean(np.abs(r[first:end] - level)) + 1e-300
        for _ in range(8):
            s0, s1, s2, b0, b1 = 0.0, 0.0, 0.0, 0.0, 0.0
            for i in range(first, end):
                weight = 1.0 / max(abs(r[i] - level - slope * t_s[i]), small)
                s0 += weight
                s1 += weight * t_s[i]
                s2 += weight * t_s[i] * t_s[i]
                b0 += weight * r[i]
                b1 += weight * r[i] * t_s[i]
            determinant = s0 * s2 - s1 * s1
            if not determinant > 1e-12 * s0 * s2:
                break
            level = (b0 * s2 - b1 * s1) / determinant
            slope = (b1 * s0 - b0 * s1) / determinant
        lines[k, 0], lines[k, 1] = level, slope


@kernel()
def gated(
    t_s: Any,
    r: Any,
    starts: Any,
    white: float,
    ou: float,
    tau_s: float,
    gate_sd: float,
    weights: Any,
    out: Any,
) -> None:
    """Whiten every window; an innovation above the gate gets weight 0 and leaves no trace."""
    for k in range(len(starts) - 1):
        level, variance = 0.0, ou
        for i in range(starts[k], starts[k + 1]):
            if i > starts[k]:
                keep = math.exp(-(t_s[i] - t_s[i - 1]) / tau_s)
                level *= keep
                variance = ou + keep * keep * (variance - ou)
            expected = max(variance + white, 1e-12 * ou)
            surprise = r[i] - level
            if weights[i] > 0.0 and abs(surprise) > gate_sd * math.sqrt(expected):
                weights[i] = 0.0
            if not weights[i] > 0.0:
                out[i] = 0.0
                continue
            out[i] = surprise / math.sqrt(expected)
            level += variance / expected * surprise
            variance *= white / expected


@kernel()
def restricted(
    t_s: Any,
    r: Any,
    weights: Any,
    starts: Any,
    white: float,
    ou: float,
    tau_s: float,
    lines: Any,
) -> tuple[float, float, float]:
    """Return squared sum, log determinant and freedom with the windows' lines projected out.

    The lines of least variance are written to `lines`.
    """
    total, log_det, freedom = 0.0, 0.0, 0.0
    step, keep = 0.0, 1.0
    for k in range(len(starts) - 1):
        first, end = starts[k], starts[k + 1]
        level0, level1, level2, variance = 0.0, 0.0, 0.0, ou
        a00, a01, a11, b0, b1, c = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        own_log_det, used = 0.0, 0
        for i in range(first, end):
            if i > first:
                if t_s[i] - t_s[i - 1] != step:
                    step = t_s[i] - t_s[i - 1]
                    keep = math.exp(-step / tau_s)
                variance = ou + keep * keep * (variance - ou)
                level0 *= keep
                level1 *= keep
                level2 *= keep
            if not weights[i] > 0.0:
                continue
            expected = max(variance + white, 1e-12 * ou)
            inverse, gain = 1.0 / expected, variance / expected
            e0, e1, e2 = r[i] - level0, 1.0 - level1, t_s[i] - level2
            level0 += gain * e0
            level1 += gain * e1
            level2 += gain * e2
            variance *= max(1.0 - gain, 0.0)
            own_log_det += math.log(expected)
            used += 1
            c += inverse * e0 * e0
            b0 += inverse * e0 * e1
            b1 += inverse * e0 * e2
            a00 += inverse * e1 * e1
            a01 += inverse * e1 * e2
            a11 += inverse * e2 * e2
        determinant = a00 * a11 - a01 * a01
        if used < 4 or not determinant > 1e-12 * a00 * a11:
            continue
        level = (b0 * a11 - b1 * a01) / determinant
        slope = (b1 * a00 - b0 * a01) / determinant
        lines[k, 0], lines[k, 1] = level, slope
        total += max(c - b0 * level - b1 * slope, 0.0)
        log_det += own_log_det + math.log(determinant)
        freedom += used - 2.0
    return total, log_det, freedom
