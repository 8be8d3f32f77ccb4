"""Which causes the residuals indicate: a score test that is valid for any noise.

For every block of the log and every direction the efficient score is computed. Their sum is
compared with the scatter of the blocks about the fitted effect, or with the noise model if that is
larger. Under "no effect" the sign of a block's residual is random, so all directions are tested
together by flipping signs of whole blocks, fitting each flip anew for the same statistic, and
taking its maximum over the directions (Westfall and Young 1993; wild bootstrap of clusters): the
family-wise error holds whatever the correlation between directions, and between samples of a block.
A block's residual is flipped, not its score: otherwise a strong effect would hide a weaker one.

If a direction shows in only three or four blocks, its scatter is hardly known, and its t has the
long tails of Student's law. One such direction would set the critical value for all others, so
every t is given as the normal deviate of equal probability.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from hilserver.arrays import Array, Indices
from hilserver.compiled import kernel
from hilserver.diagnosis.thresholds import SCREEN_LEVEL

Real = NDArray[Any]  # of 32 or 64 bits
# degrees of freedom of a direction that shows in a single block
LEAST_FREEDOM: Final = 0.5
# draws of the blocks' signs; p is at least about one over this number
FLIPS: Final = 4999


@dataclass(frozen=True)
class Scores:
    """Scores of the directions of one stage."""

    blocks: Array  # shape (blocks, k): efficient score of each block
    # shape (blocks, k): sum of squares of the efficient column over each block
    own: Array
    t: Array  # shape (k,): sum of the scores over its deviation, as a normal deviate
    deviation: Array  # shape (k,)
    # shape (k,): degrees of freedom of the deviation: blocks that count, minus one
    freedom: Array
    information: Array  # shape (k,): sum of squares of the efficient column
    gain: Array  # shape (k,): deviance that the direction would save, linearly
    size: Array  # shape (k,): step along the direction that would save it


def normal(t: Array, freedom: Array) -> Array:
    """Return the normal deviate as probable as Student's t (Wallace 1959), with the same sign."""
    scale = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
    return np.asarray(np.sign(t) * scale * np.sqrt(freedom * np.log1p(t**2 / freedom)))


def student(z: Array | float, freedom: Array) -> Array:
    """Return the t whose normal deviate is z: the inverse of `normal`."""
    scale = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
    return np.asarray(
        np.sqrt(freedom * np.expm1(np.minimum((z / scale) ** 2 / freedom, 300.0)))
    )


def freedom_of(own: Array) -> Array:
    """Return the degrees of freedom of a direction's scatter over the blocks.

    Parameters
    ----------
    own : ndarray, shape (blocks, k)
        Information of each block.
    """
    own = own.astype(np.float64)  # squares of small ones would underflow in 32 bits
    total, squares = own.sum(axis=0), (own**2).sum(axis=0)
    return np.asarray(
        np.maximum(total**2 / np.maximum(squares, 1e-300) - 1.0, LEAST_FREEDOM)
    )


@dataclass(frozen=True)
class Blocks:
    """The samples of a stage in the order of their sign-flip blocks."""

    order: Indices  # shape (n,)
    starts: Indices  # shape (blocks + 1,)

    @classmethod
    def of(cls, block: Indices, n_blocks: int) -> "Blocks":
        """Sort samples by their block."""
        counts = np.bincount(block, minlength=n_blocks)
        return cls(
            np.argsort(block, kind="stable"), np.concatenate([[0], np.cumsum(counts)])
        )

    def squares(self, columns: Real) -> Real:
        """Return the sums of squares of columns, shape (n, k), over every block."""
        bounds = zip(self.starts[:-1], self.starts[1:], strict=True)
        parts = [columns[low:high] for low, high in bounds]
        return np.stack([np.einsum("ij,ij->j", part, part) for part in parts])

    def products(self, columns: Real, others: Real) -> Array:
        """Return ``columns' others`` of every block; shapes (n, k), (n, m) give (blocks, k, m).

        Both must be in the order of the blocks.
        """
        out = np.zeros((len(self.starts) - 1, columns.shape[1], others.shape[1]))
        for b, (low, high) in enumerate(
            zip(self.starts[:-1], self.starts[1:], strict=True)
        ):
            if high > low:
                out[b] = columns[low:high].T @ others[low:high]
        return out


def score(
    columns: Real,
    left: Real,
    blocks: Blocks,
    accepted: Real | None = None,
    squares: Real | None = None,
) -> Scores:
    """Score directions against a whitened residual; all arrays are in the order of the blocks.

    The accepted causes' columns are projected out of the directions (efficient score); what is left
    of a direction within their span is rounding, not evidence.

    Parameters
    ----------
    squares : ndarray, shape (blocks, k), optional
        `Blocks.squares` of the directions, if known.
    """
    own = blocks.squares(columns) if squares is None else squares
    whole = own.sum(axis=0)
    if accepted is None or accepted.shape[1] == 0:
        per = blocks.products(columns, left[:, None])[:, :, 0]
    else:
        accepted = accepted / (np.sqrt((accepted**2).sum(axis=0)) + 1e-30)
        product = blocks.products(columns, np.column_stack([left, accepted]))
        inner = blocks.products(accepted, np.column_stack([left, accepted]))
        cross, gram = product[:, :, 1:], inner[:, :, 1:]
        weight = np.linalg.solve(
            gram.sum(axis=0) + 1e-9 * np.eye(gram.shape[1]), cross.sum(axis=0).T
        )
        per = product[:, :, 0] - inner[:, :, 0] @ weight
        own = own - 2.0 * np.einsum("bjk,kj->bj", cross, weight)
        own = own + np.einsum("kj,bkl,lj->bj", weight, gram, weight)
    information = own.sum(axis=0)
    usable = information > 1e-6 * whole + 1e-12
    per = np.where(usable, per, 0.0)
    total, safe = per.sum(axis=0), np.where(usable, information, 1.0)
    size = np.where(usable, total / safe, 0.0)
    scatter = ((per - size * own) ** 2).sum(axis=0)
    deviation = np.sqrt(np.maximum(scatter, safe))
    freedom = freedom_of(own)
    return Scores(
        per,
        own,
        np.where(usable, normal(total / deviation, freedom), 0.0),
        deviation,
        freedom,
        np.where(usable, information, 0.0),
        np.where(usable, total**2 / safe, 0.0),
        size,
    )


def null_maxima(
    scores: Sequence[Scores], rng: np.random.Generator, flips: int = FLIPS
) -> Array:
    """Return the largest |t| of every sign flip over all directions of all stages."""
    largest = np.zeros(flips)
    for s in scores:
        used = s.information > 1e-12
        if not used.any():
            continue
        own = s.own[:, used].astype(np.float64)
        information = s.information[used].astype(np.float64)
        rest = s.blocks[:, used] - s.size[used] * own
        signs = (
            rng.integers(0, 2, size=(flips, len(own))).astype(np.float64) * 2.0 - 1.0
        )
        squares = (rest**2).sum(axis=0), (own**2).sum(axis=0)
        products = signs @ rest, signs @ (rest * own)
        raise_maxima(*products, *squares, information, s.freedom[used], largest)
    return largest


@kernel()
def raise_maxima(
    total: Any,
    cross: Any,
    left: Any,
    square: Any,
    information: Any,
    freedom: Any,
    largest: Any,
) -> None:
    """Raise the largest normal deviate of every flip to that of the directions.

    Parameters
    ----------
    total, cross : ndarray, shape (flips, k)
        Sums over the flipped blocks of their residual scores, and of these times their information.
    left, square : ndarray, shape (k,)
        Sums of squares over the blocks: of the residual scores, and of their information.
    """
    flips, k = total.shape
    scale = (8.0 * freedom + 1.0) / (8.0 * freedom + 3.0)
    for f in range(flips):
        for j in range(k):
            size = total[f, j] / information[j]
            scatter = left[j] - 2.0 * size * cross[f, j] + size * size * square[j]
            t = abs(total[f, j]) / math.sqrt(max(scatter, information[j]))
            if scale[j] * t <= largest[f]:
                continue  # its normal deviate is even smaller
            z = scale[j] * math.sqrt(freedom[j] * math.log1p(t * t / freedom[j]))
            largest[f] = max(largest[f], z)


def adjusted(t: Array, maxima: Array) -> Array:
    """Return family-wise p values of |t|."""
    ordered = np.sort(maxima)
    above = len(ordered) - np.searchsorted(ordered, np.abs(t) - 1e-12, side="left")
    return np.asarray((above + 1) / (len(ordered) + 1))


def least_t(level: float) -> float:
    """Return the |t| below which not even a single test is significant."""
    return float(ndtri(1.0 - 0.5 * level))


def critical(maxima: Array, level: float = SCREEN_LEVEL) -> float:
    """Return the |t| that only a share `level` of the flips exceeds."""
    return float(np.quantile(maxima, 1.0 - level))
