"""The first difference of each signal, and how it grows."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.comparison.differing import Differing, allowances, differing
from hilserver.comparison.origin import OriginChange, changes_between
from hilserver.comparison.rows import Rows, Shared, shared_rows
from hilserver.errors import LogError
from hilserver.logs import Log

HORIZONS_S: Final = (0.0, 0.01, 0.1, 1.0, 10.0, 100.0)
"""After the first difference: largest difference until then; the last column is all of it."""


@dataclass
class Parting:
    """How one signal parts from its counterpart.

    Attributes
    ----------
    largest : ndarray, shape (len(HORIZONS_S) + 1,)
        Largest difference until each horizon after the first difference of any signal, and of all.
    """

    signal: str
    segment: int
    t_ns: int
    a: float
    b: float
    rows: int = 0
    largest: NDArray[np.float64] = field(
        default_factory=lambda: np.zeros(len(HORIZONS_S) + 1)
    )

    @property
    def t_s(self) -> float:
        """Time of the first difference [s]."""
        return self.t_ns * 1e-9

    def grow(self, found: Differing, piece: Shared, begun: tuple[int, int]) -> None:
        """Take in more differing rows; `begun`: segment and time of the very first one."""
        self.rows += len(found.at)

        # Time starts anew in each segment: later ones count as behind every horizon.
        since_s = (piece.t_ns[found.at] - begun[1]) * 1e-9
        if piece.segment != begun[0]:
            since_s = np.full(len(found.at), math.inf)
        for index, horizon_s in enumerate(HORIZONS_S):
            within = found.size[since_s <= horizon_s]
            self.largest[index] = max(self.largest[index], within.max(initial=0.0))
        self.largest[-1] = max(self.largest[-1], found.size.max())


@dataclass(frozen=True)
class RecordingComparison:
    """The outcome for two recordings.

    Attributes
    ----------
    equal_before : int
        Rows before the first difference; all of them if there is none.
    partings : list of Parting
        By time of the first difference.
    inputs : frozenset of str
        Signals that come from outside the plant.
    alone : pair of int
        Rows that only one of the recordings has.
    only_in : pair of list of str
        Signals that only one of the recordings has.
    """

    signals: int
    rows: int
    equal_before: int
    partings: list[Parting]
    inputs: frozenset[str]
    alone: tuple[int, int]
    only_in: tuple[list[str], list[str]]
    changes: list[OriginChange]

    @property
    def is_equal(self) -> bool:
        """Whether all rows and signals are in both, and equal within the tolerances."""
        return not self.partings and self.alone == (0, 0) and self.only_in == ([], [])


def compare(
    a: Iterator[Log],
    b: Iterator[Log],
    tolerances: Sequence[tuple[str, float]] = (),
) -> RecordingComparison:
    """Compare two recordings row by row, by segment and time.

    Parameters
    ----------
    a, b : iterator of Log
        Pieces of each recording, in order; a piece is dropped before the next one is read.
    tolerances : sequence of (pattern, float)
        Absolute differences that are none, in the signal's unit; the last pattern that fits counts.

    Raises
    ------
    LogError
        If they have no signal or no row in common, or a pattern fits no signal.
    """
    first = Rows(a)
    second = Rows(b)
    head_a = first.advance()
    head_b = second.advance()
    if head_a is None or head_b is None:
        empty = "first" if head_a is None else "second"
        raise LogError(
            f"the {empty} recording has no rows; there is nothing to compare"
        )
    names = [name for name in head_a.columns if name in head_b.columns]
    if not names:
        raise LogError(
            "the recordings have no signal in common; compare logs of one kind"
        )
    allowed = allowances(names, tolerances)

    partings: dict[str, Parting] = {}
    begun: tuple[int, int] | None = None
    rows = equal_before = 0
    for piece in shared_rows(first, second):
        found = [
            one for name in names if (one := differing(name, piece, allowed[name]))
        ]
        if found and begun is None:
            at = min(int(one.at[0]) for one in found)
            begun = (piece.segment, int(piece.t_ns[at]))
            equal_before = rows + at
        for one in found:
            t_ns = int(piece.t_ns[one.at[0]])
            fresh = Parting(one.signal, piece.segment, t_ns, one.a, one.b)
            parting = partings.setdefault(one.signal, fresh)
            parting.grow(one, piece, begun or (0, 0))
        rows += len(piece.t_ns)
    if not rows:
        raise LogError(
            "the recordings have no time in common; compare logs that begin at the same time"
        )

    signals = (head_a.run or {}).get("signals", ())
    only_in_a = sorted(head_a.columns.keys() - head_b.columns.keys())
    only_in_b = sorted(head_b.columns.keys() - head_a.columns.keys())
    by_time = sorted(partings.values(), key=lambda p: (p.segment, p.t_ns))
    inputs = frozenset(s["name"] for s in signals if s["direction"] == "in")
    changes = changes_between(head_a.run, head_b.run)
    return RecordingComparison(
        signals=len(names),
        rows=rows,
        equal_before=rows if begun is None else equal_before,
        partings=by_time,
        inputs=inputs,
        alone=(first.alone, second.alone),
        only_in=(only_in_a, only_in_b),
        changes=changes,
    )
