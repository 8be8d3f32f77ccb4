"""Rows that two recordings have in common, a piece at a time."""

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilserver.logs import Log
from hilserver.logs.log import NS_PER_S


class Shared(NamedTuple):
    """Rows of one segment that both have."""

    segment: int
    t_ns: NDArray[np.int64]  # shape (n,)
    a: Log
    rows_of_a: NDArray[np.intp]  # shape (n,)
    b: Log
    rows_of_b: NDArray[np.intp]  # shape (n,)


class Rows:
    """The rows of one recording, in order.

    Attributes
    ----------
    alone : int
        Rows that only this recording has.
    """

    def __init__(self, pieces: Iterator[Log]) -> None:
        self._pieces = pieces
        self._at = 0
        self.alone = 0
        self.piece: Log | None = None
        self.t_ns = np.empty(0, dtype=np.int64)

    def advance(self) -> Log | None:
        """Return the piece with the next row, None at the end."""
        while self.piece is None or self._at == len(self.piece):
            self.piece = next(self._pieces, None)
            if self.piece is None:
                return None
            self._at = 0
            # Times are compared as whole nanoseconds: two base periods give other last digits.
            self.t_ns = np.rint(self.piece.t_s * NS_PER_S).astype(np.int64)
        return self.piece

    @property
    def segment(self) -> int:
        """Segment of the next row."""
        assert self.piece is not None
        return int(self.piece.segment[self._at])

    def until(self, segment: int) -> slice:
        """Return the rows in hand that belong to `segment` or an earlier one."""
        assert self.piece is not None
        end = int(np.searchsorted(self.piece.segment, segment, side="right"))
        return slice(self._at, end)

    def use(self, end: int, shared: int) -> None:
        """Go on behind row `end`, of which `shared` were in the other recording, too."""
        self.alone += end - self._at - shared
        self._at = end

    def leave_rest(self) -> None:
        """Count what comes after the end of the other recording."""
        while (piece := self.advance()) is not None:
            self.use(len(piece), 0)


def shared_rows(a: Rows, b: Rows) -> Iterator[Shared]:
    """Yield the rows that both have, in order; the others are counted as `alone`."""
    while (log_a := a.advance()) is not None and (log_b := b.advance()) is not None:
        segment = max(a.segment, b.segment)
        if a.segment != b.segment:
            behind = a if a.segment < segment else b
            behind.use(behind.until(segment - 1).stop, 0)
            continue

        of_a = a.until(segment)
        of_b = b.until(segment)
        end_of_a = a.t_ns[of_a.stop - 1]
        end_of_b = b.t_ns[of_b.stop - 1]
        last_ns = min(end_of_a, end_of_b)
        n_a = int(np.searchsorted(a.t_ns[of_a], last_ns, side="right"))
        end_a = of_a.start + n_a
        n_b = int(np.searchsorted(b.t_ns[of_b], last_ns, side="right"))
        end_b = of_b.start + n_b
        times_a = a.t_ns[of_a.start : end_a]
        times_b = b.t_ns[of_b.start : end_b]
        t_ns, in_a, in_b = np.intersect1d(
            times_a,
            times_b,
            assume_unique=True,
            return_indices=True,
        )
        if len(t_ns):
            yield Shared(
                segment, t_ns, log_a, in_a + of_a.start, log_b, in_b + of_b.start
            )
        a.use(end_a, len(t_ns))
        b.use(end_b, len(t_ns))
    a.leave_rest()
    b.leave_rest()
