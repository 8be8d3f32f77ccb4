"""The sensitivities of all candidates of a stage, whitened and laid out for the screen."""

from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np

from hilserver.arrays import Array, Columns, Indices, Mask
from hilserver.compiled import kernel
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.screen import Blocks, Scores, score

RIDGE = 1e-3
SQUARE: Final = ((1.0, 0.0), (0.0, 1.0), (0.7071, 0.7071), (0.7071, -0.7071))
"""The directions in which a candidate of two parameters is examined."""
AT_ONCE: Final = 8
"""Candidates that are whitened together, sharing table rows and memory."""


@dataclass
class Library:
    """The candidates of one stage with their whitened columns at the base model."""

    problem: Problem
    candidates: list[Candidate]
    raw: list[Columns]  # shape (n, 1): sensitivities of every candidate
    blocks: Blocks = field(init=False)  # order of the rows of `columns`
    # shape (k,): candidate of each direction
    owner: Indices = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    # shape (n, k): all directions, whitened, initial poses projected out
    columns: Columns = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    # shape (blocks, k): sums of their squares
    squares: Columns = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    # lengths of columns, if there are several
    norms: list[Array] = field(default_factory=list)

    def __post_init__(self) -> None:
        stack = self.problem.stack
        self.blocks = Blocks.of(stack.block, stack.n_blocks)
        widths = [1 if r.shape[1] == 1 else len(SQUARE) for r in self.raw]
        self.owner = np.repeat(np.arange(len(self.raw)), widths)
        self.columns = np.empty((len(stack), int(sum(widths))), dtype=np.float32)
        self._made_for: tuple[object, object] = (None, None)

    def rewhiten(self, point: Point) -> None:
        """Whiten and project all columns with the problem's current noise."""
        problem = self.problem
        bases, begin = problem.bases_at(point), 0
        noise, known = self._made_for
        if noise is problem.noise and (bases is None or known is point):
            return
        self.norms = []
        for first in range(0, len(self.raw), AT_ONCE):
            some = self.raw[first : first + AT_ONCE]
            table = np.concatenate(some, axis=1, dtype=np.float64)
            white = problem.project(problem.whiten(table), bases)
            widths = np.array([raw.shape[1] for raw in some])
            ends, length = np.cumsum(widths), np.ones(white.shape[1])
            if white.shape[1] > len(some):
                own = np.sqrt((white**2).sum(axis=0)) + 1e-30
                length = np.where(np.repeat(widths, widths) > 1, own, length)
            self.norms += np.split(length, ends[:-1])
            sides = [SQUARE[: 1 if width == 1 else None] for width in widths]
            place = np.repeat(ends - widths, [len(own) for own in sides])
            end = begin + len(place)
            weight, part = np.concatenate(sides), self.columns[:, begin:end]
            lay_out(white, length, place, weight, self.blocks.order, part)
            begin = end
        self.squares, self._made_for = (
            self.blocks.squares(self.columns),
            (problem.noise, point),
        )

    def ridge(self, point: Point, rows: Mask | None = None) -> Array:
        """Return coefficients of all directions at once for the residual of a model.

        Parameters
        ----------
        rows : ndarray of bool, shape (n,), optional
            Samples that count, in the order of the blocks; by default all.
        """
        chosen = slice(None) if rows is None else rows
        columns = self.columns[chosen]
        squares = np.einsum("ij,ij->j", columns, columns).astype(np.float64)
        norm = np.sqrt(squares) + 1e-30  # its square would underflow in 32 bits
        gram = (columns.T @ columns).astype(np.float64) / np.outer(norm, norm)
        left = point.left[self.blocks.order][chosen].astype(np.float32)
        along = (columns.T @ left).astype(np.float64) / norm
        return np.asarray(
            np.linalg.solve(gram + RIDGE * np.eye(len(norm)), along) / norm
        )

    def effect(self, weight: Array, rows: Indices | slice) -> Array:
        """Return what coefficients of all directions add to the prediction of some samples."""
        total = np.zeros(len(self.problem.stack))[rows]
        for i, raw in enumerate(self.raw):
            mine = weight[self.owner == i]
            theta = (
                mine if raw.shape[1] == 1 else np.array(SQUARE).T @ mine / self.norms[i]
            )
            total += raw[rows] @ theta
        return np.asarray(total)

    def scores(self, point: Point) -> Scores:
        """Score all candidates at a model."""
        accepted = self.problem.accepted(point)
        order = self.blocks.order
        return score(
            self.columns,
            point.left[order].astype(np.float32),
            self.blocks,
            None if accepted is None else accepted[order].astype(np.float32),
            self.squares,
        )


@kernel()
def lay_out(
    white: Any, length: Any, place: Any, weight: Any, order: Any, out: Any
) -> None:
    """Write directions of whitened columns, with the samples in a given order.

    Parameters
    ----------
    length : ndarray, shape (columns,)
        By which columns are divided.
    place : ndarray of int, shape (k,)
        First column of the candidate, for each direction.
    weight : ndarray, shape (k, 2)
        Weights of this column and the next.
    out : ndarray, shape (n, k)
        Output.
    """
    for r in range(len(order)):
        row = white[order[r]]
        for j in range(len(place)):
            at = place[j]
            value = weight[j, 0] * (row[at] / length[at])
            if weight[j, 1] != 0.0:
                value += weight[j, 1] * (row[at + 1] / length[at + 1])
            out[r, j] = value
