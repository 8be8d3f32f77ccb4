"""Position noise as a real ultra-wideband system has it, drawn in blocks from a recording."""

import os
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
BLOCK_S = 8.0
ANCHORS = np.array(
    [
        (-3.42, 3.01),
        (0.00, 3.01),
        (3.61, 2.98),
        (3.60, 0.00),
        (3.57, -3.01),
        (-0.01, -2.97),
        (-3.47, -2.96),
        (-3.49, -0.01),
    ]
)
ANCHOR_Z = 1.04
TAG = np.array([0.2034, 0.1451])


class NoRecordingError(RuntimeError):
    """The folder of the recordings is not there."""


def blocks_of_residuals(rng: np.random.Generator, times: Array) -> tuple[Array, Array]:
    """Return errors of x and y [m] at these instants, by moving blocks of `BLOCK_S` seconds.

    Raises
    ------
    NoRecordingError
        Without ``HIL_DATA_DIR`` or the recording in it.
    """
    folder = os.environ.get("HIL_DATA_DIR")
    if not folder or not (Path(folder) / "uwb_trolley").is_dir():
        msg = "HIL_DATA_DIR names no folder with uwb_trolley: measured position noise needs it."
        raise NoRecordingError(msg)
    known, errors = residuals(folder)
    result = np.empty((2, len(times)))
    at = 0.0
    while at <= times[-1]:
        inside = (times >= at) & (times < at + BLOCK_S)
        begin = rng.uniform(known[0], known[-1] - BLOCK_S)
        for axis in range(2):
            result[axis, inside] = np.interp(
                times[inside] - at + begin, known, errors[axis]
            )
        at += BLOCK_S
    return result[0], result[1]


@cache
def residuals(folder: str) -> tuple[Array, Array]:
    """Return stamps [s] and errors, shape (2, n), of positions trilaterated from the ranges.

    The mean error of each axis is removed: a constant offset is a matter of mounting.
    """
    path = Path(folder) / "uwb_trolley"
    stamps, ranges = _columns(path / "UWB_dynamic_exp_mid.csv", slice(1, 25), 0)
    known, truth = _columns(path / "motion_capture_dynamic_exp_mid.csv", slice(1, 8), 1)
    inside = (stamps > known[0]) & (stamps < known[-1])
    stamps, ranges = stamps[inside], ranges[inside][:, 2::3]
    x, y, z, w, qx, qy, qz = (np.interp(stamps, known, column) for column in truth.T)
    yaw = np.arctan2(2.0 * (w * qz + qx * qy), 1.0 - 2.0 * (qy**2 + qz**2))
    place = np.stack(
        [
            x + TAG[0] * np.cos(yaw) - TAG[1] * np.sin(yaw),
            y + TAG[0] * np.sin(yaw) + TAG[1] * np.cos(yaw),
        ]
    )
    true_ranges = np.sqrt(
        ((place.T[:, None, :] - ANCHORS) ** 2).sum(axis=2)
        + (z[:, None] - ANCHOR_Z) ** 2
    )
    errors = ranges - true_ranges
    errors = errors - np.median(errors, axis=0)
    away = (place.T[:, None, :] - ANCHORS) / np.maximum(true_ranges, 0.3)[:, :, None]
    normal = np.einsum("nki,nkj->nij", away, away)
    moved = np.linalg.solve(normal, np.einsum("nki,nk->ni", away, errors)[:, :, None])[
        :, :, 0
    ]
    moved = moved - moved.mean(axis=0)
    return stamps, moved.T


def _columns(path: Path, which: slice, header: int) -> tuple[Array, Array]:
    stamps, rows = [], []
    for line in path.read_text(encoding="utf-8").splitlines()[header:]:
        words = line.split(",")
        stamps.append(
            np.datetime64(words[0].replace(" ", "T").replace("T9:", "T09:"), "ns")
        )
        rows.append([float(word or "nan") for word in words[which]])
    seconds = (np.array(stamps) - np.datetime64("2022-08-15T00:00:00", "ns")).astype(
        float
    ) * 1e-9
    table = np.array(rows)
    good = np.isfinite(table).all(axis=1)
    return seconds[good], table[good]
