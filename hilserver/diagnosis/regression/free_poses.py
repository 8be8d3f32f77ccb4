"""Initial poses of all segments, free in every fit: their bases, projection and best step."""

import math
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.compiled import kernel

RANK: Final = 1e-9
"""Share of the largest singular value below which a direction of the pose has no effect."""


@dataclass(frozen=True)
class FreePoses:
    """The samples of each segment: the columns of its initial pose affect no others."""

    order: Indices  # shape (n,): samples, segment by segment
    # shape (segments + 1,): where each segment begins and ends in `order`
    ends: Indices

    @classmethod
    def of(cls, segment: Indices, segments: int) -> "FreePoses":
        """Sort samples by segment, shape (n,); some of the `segments` may have no samples."""
        counts = np.bincount(segment, minlength=segments)
        ends = np.concatenate([[0], np.cumsum(counts)]).astype(np.int64)
        return cls(np.argsort(segment, kind="stable"), ends)

    def bases(self, columns: Array) -> "Bases":
        """Return what whitened pose columns, shape (n, 3), explain."""
        unit, upper = np.empty_like(columns), np.zeros((len(self.ends) - 1, 3, 3))
        orthonormal(columns, self.order, self.ends, unit, upper)
        u, s, vt = np.linalg.svd(upper)
        shown = s > RANK * s[:, :1]
        u = np.where(shown[:, None, :], u, 0.0)
        inverse = np.divide(1.0, s, out=np.zeros_like(s), where=shown)
        ut = u.transpose(0, 2, 1)
        return Bases(
            self, unit, u @ ut, vt.transpose(0, 2, 1) @ (inverse[:, :, None] * ut)
        )


@dataclass(frozen=True)
class Bases:
    """Orthonormal bases of the pose columns of all segments."""

    of: FreePoses
    unit: Array  # shape (n, 3): rows of the bases
    # shape (segments, 3, 3): projects onto the basis directions that have an effect in the segment,
    # nearly always all; from a segment's components along its basis to the step of its pose
    shown: Array
    solved: Array

    def project(self, white: Array) -> Array:
        """Return whitened columns, shape (n,) or (n, k), without what the poses explain."""
        table = np.ascontiguousarray(white if white.ndim > 1 else white[:, None])
        out = np.empty_like(table)
        subtract(table, self.of.order, self.of.ends, self.unit, self.shown, out)
        return out.reshape(white.shape)

    def step(self, white: Array) -> Array:
        """Return the step of the poses, shape (segments, 3), that explains most of a residual."""
        product = (self.unit * white[:, None])[self.of.order]
        along = np.zeros((len(self.of.ends) - 1, 3))
        some = np.flatnonzero(np.diff(self.of.ends))
        if len(some):
            along[some] = np.add.reduceat(product, self.of.ends[some], axis=0)
        return np.asarray((self.solved @ along[:, :, None])[:, :, 0])


@kernel()
def orthonormal(columns: Any, order: Any, ends: Any, unit: Any, upper: Any) -> None:
    """Write bases of each segment's columns, and the columns in these bases (Gram-Schmidt, twice).

    A column that the previous ones explain, except for rounding, gets a basis of zeros.
    """
    for s in range(len(ends) - 1):
        rows = order[ends[s] : ends[s + 1]]
        for j in range(3):
            before = 0.0
            for r in rows:
                unit[r, j] = columns[r, j]
                before += columns[r, j] * columns[r, j]
            for _ in range(2):
                for i in range(j):
                    along = 0.0
                    for r in rows:
                        along += unit[r, i] * unit[r, j]
                    for r in rows:
                        unit[r, j] -= along * unit[r, i]
                    upper[s, i, j] += along
            square = 0.0
            for r in rows:
                square += unit[r, j] * unit[r, j]
            length = math.sqrt(square) if square > 1e-28 * before else 0.0
            upper[s, j, j] = length
            for r in rows:
                unit[r, j] = unit[r, j] / length if length > 0.0 else 0.0


@kernel()
def subtract(
    white: Any, order: Any, ends: Any, unit: Any, shown: Any, out: Any
) -> None:
    """Write columns without their projections onto each segment's basis."""
    width = white.shape[1]
    along, part = np.empty((3, width)), np.empty((3, width))
    for s in range(len(ends) - 1):
        rows = order[ends[s] : ends[s + 1]]
        along[:] = 0.0
        for r in rows:
            for i in range(3):
                share = unit[r, i]
                for k in range(width):
                    along[i, k] += share * white[r, k]
        for i in range(3):
            for k in range(width):
                part[i, k] = (
                    shown[s, i, 0] * along[0, k]
                    + shown[s, i, 1] * along[1, k]
                    + shown[s, i, 2] * along[2, k]
                )
        for r in rows:
            a, b, c = unit[r, 0], unit[r, 1], unit[r, 2]
            for k in range(width):
                out[r, k] = white[r, k] - (
                    a * part[0, k] + b * part[1, k] + c * part[2, k]
                )
