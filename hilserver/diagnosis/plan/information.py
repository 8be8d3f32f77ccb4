"""The information of measurements about every cause, as sums over stretches: Gram matrices.

The whitened sensitivities of a stretch, with its initial pose projected out, have a Gram matrix.
Those of stretches that each begin with their own pose add up, so that the information of a
sequence of pieces is known before the sequence exists; joined pieces share a pose and hold more.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.vocabulary import reference
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.thresholds import DETECTABLE_POWER_SD, RIVAL_CLEAR_Z, TIE

T_NEEDED: Final = 5.5
"""Deviations at which an effect is found with good power in a log of a minute and more."""
Z_APART: Final = RIVAL_CLEAR_Z + DETECTABLE_POWER_SD
"""Standard errors between the deviances of an effect and its best imitation at which a diagnosis
tells them apart with good power."""
SEEN: Final = 0.5  # worth of seeing a cause, relative to separating it from all others
ENOUGH_TIMES: Final = 3.0
LINEAR_REACH: Final = 1.5
"""How far a column of an effect that is not linear may be extrapolated, in its own size."""


@dataclass(frozen=True)
class GramDirection:
    """One candidate in the Gram matrix."""

    candidate: Candidate
    rows: tuple[int, ...]  # one row per parameter, at most two
    units: tuple[float, ...]  # physical size of a step of 1 along each row
    sizes: tuple[float | None, ...]  # reference sizes of the parameters

    @property
    def cause(self) -> str:
        """Public name."""
        return self.candidate.cause


def directions_of(library: Library) -> list[GramDirection]:
    """Return where each candidate lies in the Gram matrix of a library's columns."""
    found = []
    for i, c in enumerate(library.candidates):
        rows = tuple(int(j) for j in np.flatnonzero(library.owner == i)[: min(c.n, 2)])
        names = list(c.terms(tuple(0.5 * s for s in c.step)))
        sizes = tuple(reference(c.cause, n) for n in names[:2])
        if (
            c.is_limit and sizes[0]
        ):  # a share of it is its reference value divided by that share
            units: tuple[float, ...] = (sizes[0] ** 2 / c.start[0],)
        elif not c.linear:
            units = (abs(c.start[0] - c.null[0]),)
        else:
            units = (
                (1.0,) if c.n == 1 else tuple(1.0 / float(n) for n in library.norms[i])
            )
        found.append(GramDirection(c, rows, units, sizes))
    return found


def gram_of(library: Library) -> Array:
    """Return the Gram matrix of a library's columns, shape (k, k)."""
    columns = library.columns.astype(np.float64)
    return np.asarray(columns.T @ columns)


def grams_by_span(library: Library, n_spans: int) -> Array:
    """Return the Gram matrix of each span of a log, shape (spans, k, k)."""
    stack = library.problem.stack
    span = library.problem.stage.segments.span[stack.segment][library.blocks.order]
    k = library.columns.shape[1]
    out = np.zeros((n_spans, k, k))
    for i in range(n_spans):
        columns = library.columns[span == i].astype(np.float64)
        out[i] = columns.T @ columns
    return out


def sizes_of(
    directions: Sequence[GramDirection], gram: Array, needed: float = T_NEEDED
) -> Array:
    """Return the smallest detectable size of each candidate as a share of its reference size.

    Infinite where a candidate cannot be seen or has no reference size.
    """
    out = np.full(len(directions), np.inf)
    squares = np.diag(gram)
    for i, d in enumerate(directions):
        for row, unit, size in zip(d.rows, d.units, d.sizes, strict=False):
            if squares[row] <= 1e-12 or size is None:
                continue
            steps = needed / np.sqrt(squares[row])
            if d.candidate.linear or steps <= LINEAR_REACH:
                out[i] = min(out[i], steps * unit / size)
    return out


def alike(directions: Sequence[GramDirection], gram: Array) -> Array:
    """Return the |cos| of any two candidates' sensitivities, shape (m, m).

    For candidates with two parameters it is the largest over their directions (canonical
    correlation): then some effect of the one looks like some effect of the other.
    """
    m = len(directions)
    # each candidate gets an orthonormal pair of rows; a single parameter leaves the second empty
    turn = np.zeros((m, 2, len(gram)))
    for i, d in enumerate(directions):
        rows = list(d.rows)
        block = gram[np.ix_(rows, rows)]
        scale = np.sqrt(np.maximum(np.diag(block), 1e-300))
        value, vector = np.linalg.eigh(block / np.outer(scale, scale))
        good = value > 1e-6
        inverse = np.where(good, 1.0 / np.sqrt(np.where(good, value, 1.0)), 0.0)
        if np.diag(block).max(initial=0.0) > 1e-12:
            turn[i][: len(rows), rows] = (inverse[:, None] * vector.T) / scale
    flat = turn.reshape(2 * m, len(gram))
    cross = (flat @ gram @ flat.T).reshape(m, 2, m, 2).transpose(0, 2, 1, 3)
    total = (cross**2).sum(axis=(2, 3))
    det = cross[..., 0, 0] * cross[..., 1, 1] - cross[..., 0, 1] * cross[..., 1, 0]
    largest = 0.5 * (total + np.sqrt(np.maximum(total**2 - 4.0 * det**2, 0.0)))
    return np.asarray(np.sqrt(np.clip(largest, 0.0, 1.0)))


def apart(directions: Sequence[GramDirection], gram: Array) -> Array:
    """Return how clearly each candidate at its reference size beats its imitations, shape (m, m).

    Row i is the truth and column j the rival. What the rival cannot imitate is x deviations long;
    its deviance is then larger by about x^2 with a standard error of 2 x, plus a diagnosis' penalty
    for every additional parameter. 0 if the difference is too small to count; infinite for a truth
    without a reference size.
    """
    sized = np.array([any(d.sizes) for d in directions])
    t = np.where(sized, T_NEEDED / sizes_of(directions, gram), 0.0)
    x = t[:, None] * np.sqrt(np.maximum(1.0 - alike(directions, gram) ** 2, 0.0))
    weight = np.array([d.candidate.weight for d in directions])
    worse = x**2 + TIE * (weight[None, :] - weight[:, None])
    z = np.where(worse > TIE + 0.01, worse / (2.0 * x + 1e-9), 0.0)
    return np.asarray(np.where(sized[:, None], z, np.inf))


def score(directions: Sequence[GramDirection], gram: Array) -> float:
    """Return the worth for a diagnosis: small sizes and clear names of all sized causes."""
    shares, z, total = sizes_of(directions, gram), apart(directions, gram), 0.0
    owner = np.array([d.cause for d in directions])
    for cause, mine in nearest(directions).items():
        share = float(shares[owner == cause].min())
        if not any(directions[mine[0]].sizes) or not share < np.inf:
            continue
        clear = float(np.median(z[mine][:, owner != cause].min(axis=1))) / Z_APART
        total += SEEN * _worth(1.0 / share) + _worth(clear)
    return total


def _worth(times: float) -> float:
    """Return 1 for just enough; what exceeds it is worth less and less."""
    return float(np.log2(1.0 + min(max(times, 0.0), ENOUGH_TIMES)))


def nearest(directions: Sequence[GramDirection]) -> dict[str, list[int]]:
    """Return the candidates that represent each cause: of several start values, the nearest one.

    A cause with several shapes (regions of the floor, wheels) keeps them all.
    """
    found: dict[str, list[int]] = {}
    for i, d in enumerate(directions):
        found.setdefault(d.cause, []).append(i)
    for cause, mine in found.items():
        sizes = [d.units[0] / s for i in mine if not (d := directions[i]).candidate.linear
                 and (s := d.sizes[0])]  # fmt: skip
        if len(sizes) == len(mine):
            found[cause] = [mine[int(np.argmin(np.abs(np.log(sizes))))]]
    return found
