"""The steps of a recorded quantity, below its noise: a line in the spectrum of its values.

The characteristic function of values rounded to whole multiples of q has a line at 1/q, however
much noise is added; noise of deviation s weakens it by exp(-2 pi^2 s^2 / q^2).
"""

from collections.abc import Sequence
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.thresholds import (
    COMB_CLEAR,
    COMB_FEWEST,
    COMB_TIMES,
    FEWEST_SAMPLES,
    HALF,
)

STEPS_RPM: Final = (0.2, 6.0)  # steps that are searched; finer ones are below the noise
MOST_LINES: Final = 8  # lines of the spectrum that are examined
NOTICEABLE: Final = 0.02  # least coefficient of a line that is a candidate
PADDED = 4
SAMPLES = 6_000
NEIGHBOURS = 8


def coarse_step(channels: Sequence[Array], smooth: Sequence[Array]) -> float | None:
    """Return the step in which quantities of one kind come; None if they are smooth.

    Parameters
    ----------
    channels, smooth : sequence of ndarray, shape (n,)
        Measured values, and what they would be without rounding.
    """
    best = None
    for step in _suspects(channels, smooth):
        pairs = [lattice(v, s, step) for v, s in zip(channels, smooth, strict=True)]
        rounded, follows = (float(np.mean(part)) for part in zip(*pairs, strict=True))
        clear = rounded > max(COMB_CLEAR, COMB_TIMES * follows) and (
            best is None or rounded > best[0]
        )
        if clear and on_the_way(channels, step) > HALF * rounded:
            best = (rounded, step)
    return None if best is None else best[1]


def _suspects(channels: Sequence[Array], smooth: Sequence[Array]) -> list[float]:
    """Return steps whose lines stand out from the spectrum of the smooth values."""
    thinned = [
        (v[:: max(1, len(v) // SAMPLES)], s[:: max(1, len(v) // SAMPLES)])
        for v, s in zip(channels, smooth, strict=True)
        if len(v) >= COMB_FEWEST
    ]
    if not thinned:
        return []
    low, high = min(v.min() for v, _ in thinned), max(v.max() for v, _ in thinned)
    width = STEPS_RPM[0] / 8.0
    if not width < high - low < 1e6 * width:
        return []
    edges = np.arange(low, high + 2.0 * width, width)
    frequency = np.arange(PADDED * len(edges) // 2 + 1) / (PADDED * len(edges) * width)
    line = np.zeros(len(frequency))
    for v, s in thinned:
        noise = 1.4826 * float(np.median(np.abs(v - s)))
        faded = np.exp(-2.0 * (np.pi * noise * frequency) ** 2)
        line += (_spectrum(v, edges) - faded * _spectrum(s, edges)) / len(thinned)
    inside = (frequency >= 1.0 / STEPS_RPM[1]) & (frequency <= 1.0 / STEPS_RPM[0])
    line = np.where(inside, line, 0.0)
    found: list[float] = []
    while len(found) < MOST_LINES and line.max(initial=0.0) > NOTICEABLE:
        peak = int(line.argmax())
        values = [v for v, _ in thinned]
        found.append(
            1.0 / _sharpened(values, float(frequency[peak]), float(frequency[1]))
        )
        line[max(peak - PADDED, 0) : peak + PADDED + 1] = 0.0
    return found


def _spectrum(values: Array, edges: Array) -> Array:
    counts, _ = np.histogram(values, edges)
    return np.asarray(np.abs(np.fft.rfft(counts, n=PADDED * len(edges))) / len(values))


def lattice(values: Array, smooth: Array, step: float) -> tuple[float, float]:
    """Return how closely values keep to multiples of a step, and how closely to smooth ones.

    Parameters
    ----------
    values, smooth : ndarray, shape (n,)
        Measured values, and what they would be without rounding.

    Returns
    -------
    tuple of float
        Coefficients of ``exp(2 pi i values/q)`` on 1 and on ``exp(2 pi i smooth/q)``: the first is
        present only with rounding, the second only without. Both decrease with the noise.
    """
    turned = 2j * np.pi / step
    columns = np.stack([np.ones(len(values)), np.exp(turned * smooth)], axis=1)
    gram = columns.conj().T @ columns + 1e-3 * len(values) * np.eye(2)
    rounded, follows = np.linalg.solve(gram, columns.conj().T @ np.exp(turned * values))
    return float(rounded.real), float(abs(follows))


def on_the_way(channels: Sequence[Array], step: float) -> float:
    """Return the coefficient of values on multiples of a step while they pass more than one.

    A wheel that a load keeps from its set-points rests at few speeds, and any few speeds are
    multiples of some step. Only rounded values keep to it on the way between them.
    """
    passing = []
    for values in channels:
        here = values[NEIGHBOURS:-NEIGHBOURS]
        before, after = (
            here - values[: -2 * NEIGHBOURS],
            values[2 * NEIGHBOURS :] - here,
        )
        one_way = (np.minimum(before, after) > step) | (
            np.maximum(before, after) < -step
        )
        passing.append(here[one_way])
    found = np.concatenate(passing)
    return (
        float(np.cos(2.0 * np.pi / step * found).mean())
        if len(found) > FEWEST_SAMPLES
        else 0.0
    )


def _sharpened(values: list[Array], frequency: float, width: float) -> float:
    """Return the frequency of the line near one of the discrete transform."""
    for _ in range(8):
        tries = frequency + width * np.linspace(-1.0, 1.0, 9)
        size = [
            sum(abs(np.exp(2j * np.pi * f * v).mean()) for v in values) for f in tries
        ]
        frequency, width = float(tries[int(np.argmax(size))]), 0.3 * width
    return frequency
