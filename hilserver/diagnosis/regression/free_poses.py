"""Initial poses of all segments, free in every fit: their bases, projection and best step."""

from typing import Final

import numpy as np

from hilserver.arrays import Array, Indices

Bases = list[Array]
AT_ONCE: Final = 32
"""Segments with equally many samples are solved together; of more the copies would fill memory."""
RANK: Final = 1e-9
"""Share of the largest singular value below which a direction of the pose shows nothing."""


class FreePoses:
    """The columns of the initial poses touch their own segment alone.

    Parameters
    ----------
    segment : ndarray of int64, shape (n,)
        Of each sample.
    segments : int
        How many there are, with and without samples.
    """

    def __init__(self, segment: Indices, segments: int) -> None:
        self._segments = segments
        order = np.argsort(segment, kind="stable")
        _, first, count = np.unique(segment[order], return_index=True, return_counts=True)
        self._rows: list[Indices] = []
        for n in np.unique(count):
            alike = first[count == n]
            for begin in range(0, len(alike), AT_ONCE):
                some = alike[begin : begin + AT_ONCE]
                self._rows.append(order[some[:, None] + np.arange(n)])
        self._owner = [segment[rows[:, 0]] for rows in self._rows]

    def bases(self, columns: Array) -> Bases:
        """Return orthonormal bases of whitened pose columns, for `project`.

        Parameters
        ----------
        columns : ndarray, shape (n, 3)
        """
        found = []
        for rows in self._rows:
            u, s, _ = np.linalg.svd(columns[rows], full_matrices=False)
            shown = s > RANK * np.maximum(s[:, :1], 1e-30)
            found.append(np.where(shown[:, None, :], u, 0.0))
        return found

    def project(self, white: Array, bases: Bases) -> Array:
        """Return whitened columns, shape (n,) or (n, k), without what the poses explain."""
        out = white.copy()
        two = out[:, None] if out.ndim == 1 else out
        for rows, base in zip(self._rows, bases, strict=True):
            part = two[rows]
            two[rows] = part - base @ (base.transpose(0, 2, 1) @ part)
        return out

    def step(self, columns: Array, white: Array) -> Array:
        """Return the step of the poses, shape (segments, 3), that explains most of a residual."""
        step = np.zeros((self._segments, 3))
        for rows, owner in zip(self._rows, self._owner, strict=True):
            u, s, vt = np.linalg.svd(columns[rows], full_matrices=False)
            shown = s > RANK * s[:, :1]
            along = (u.transpose(0, 2, 1) @ white[rows][:, :, None])[:, :, 0]
            size = np.divide(along, s, out=np.zeros_like(s), where=shown)
            step[owner] = (vt.transpose(0, 2, 1) @ size[:, :, None])[:, :, 0]
        return step
