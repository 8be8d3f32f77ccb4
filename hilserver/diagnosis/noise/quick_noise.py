"""Noise of channels that need no likelihood: white ones, and those without memory."""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy.ndimage import median_filter

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.noise.readings import FLOOR_SD
from hilserver.diagnosis.noise.whitening import NoiseModel
from hilserver.diagnosis.thresholds import (
    FAR_SD,
    NOISE_FEW_FAR,
    NOISE_WHITE,
    OUTLIER_SD,
    OUTLIERS_IN_A_ROW,
)

AROUND_S: Final = 1.05  # width of the median from which a spike stands out
WITHIN_3_SD = 0.97334
"""Variance of a normal variable within three deviations, as a share of the full variance."""


def isolated(white: Array) -> Mask:
    """Return which samples are outliers: far off, and only a few in a row."""
    bad = np.abs(white) > OUTLIER_SD
    edges = np.flatnonzero(
        np.diff(np.concatenate([[False], bad, [False]]).astype(np.int8))
    )
    out = np.zeros(len(bad), dtype=bool)
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        if end - begin <= OUTLIERS_IN_A_ROW:
            out[begin:end] = True
    return out


def spikes(t_s: Array, residual: Array) -> Mask:
    """Return which samples are far from their neighbours, alone or in a burst."""
    if len(t_s) < 20:
        return np.zeros(len(t_s), dtype=bool)
    away = np.abs(deviation_from_median(t_s, residual))
    return np.asarray(away > OUTLIER_SD * 1.4826 * max(float(np.median(away)), 1e-9))


def deviation_from_median(t_s: Array, residual: Array) -> Array:
    """Return how far samples are from the median around them.

    A burst of up to half of `AROUND_S` does not move it.
    """
    if len(t_s) < 2:
        return np.zeros(len(t_s))
    width = round(AROUND_S / max(float(np.median(np.diff(t_s))), 1e-6)) // 2 * 2 + 1
    return np.asarray(
        residual - median_filter(residual, size=max(width, 5), mode="nearest")
    )


def plain_noise(parts: Sequence[tuple[Array, Array]]) -> NoiseModel | None:
    """Return white noise if the residuals show no correlation at all, else None."""
    pieces = [r for _, r in parts if len(r) > 20]
    if not pieces:
        return None
    far = FAR_SD * 1.4826 * float(np.median(np.abs(np.concatenate(pieces))))
    if np.mean(np.abs(np.concatenate(pieces)) > far) > NOISE_FEW_FAR:
        # outliers would count as noise, and hide the correlation of the rest
        return None
    power = sum(float(r @ r) for r in pieces)
    if power <= 0.0:
        return None
    for lag in (1, 2, 4, 8, 16):
        together = sum(float(r[lag:] @ r[:-lag]) for r in pieces)
        if abs(together) > NOISE_WHITE * power:
            return None
    return NoiseModel(float(np.sqrt(power / sum(len(r) for r in pieces))))


def noise_of_neighbours(parts: Sequence[tuple[Array, Array]]) -> NoiseModel:
    """Return the white noise that neighbouring samples show.

    The drive's sensors have no memory: what is correlated there is an effect, and except in
    transients it is the same for two neighbours.
    """
    steps = np.concatenate([np.diff(r) for _, r in parts])
    sd = 1.4826 * float(np.median(np.abs(steps))) / np.sqrt(2.0) if len(steps) else 0.0
    quiet = steps[np.abs(steps) < 3.0 * np.sqrt(2.0) * sd]
    if len(quiet):  # the median alone would use a third of the samples
        sd = float(np.sqrt(np.mean(quiet**2) / 2.0 / WITHIN_3_SD))
    if sd <= 0.0 and len(steps):
        sd = float(np.std(steps)) / np.sqrt(2.0)
    return NoiseModel(max(sd, FLOOR_SD))
