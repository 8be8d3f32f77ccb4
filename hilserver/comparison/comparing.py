"""Two recordings: where each signal parts first, how that grows, and how their origins differ."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fnmatch import fnmatchcase
from functools import cache
from typing import Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilserver.comparison.rows import Rows, Shared, shared_rows
from hilserver.errors import LogError, meant
from hilserver.logs import Log
from hilserver.logs.provenance import configuration_of
from hilserver.measured.names import known_signals

HORIZONS_S: Final = (0.0, 0.01, 0.1, 1.0, 10.0, 100.0)
"""After the first difference: largest difference until then; the last column is all of it."""
_OF_THE_RUN: Final = ("version", "kernels", "seed", "base_period_ns", "patch")
_ABSENT: Final = "(not set)"


class Differing(NamedTuple):
    """The rows of a piece in which a signal differs, and both values in the first of them."""

    signal: str
    at: NDArray[np.intp]  # shape (n,)
    size: NDArray[np.float64]  # shape (n,)
    a: float
    b: float


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


class OriginChange(NamedTuple):
    """One entry that is not the same, by its key, and its two values as text."""

    key: str
    a: str
    b: str


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
        Those of both recordings that come from outside the plant.
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


@dataclass
class _Partings:
    """Where each signal parts, found piece by piece."""

    names: list[str]
    allowed: dict[str, float]
    by_signal: dict[str, Parting] = field(default_factory=dict)
    rows: int = 0
    # segment and time of the very first difference, and the rows before it
    begun: tuple[int, int] | None = None
    equal_before: int = 0

    def take(self, piece: Shared) -> None:
        """Look at more rows of both."""
        found = []
        for name in self.names:
            one = differing(name, piece, self.allowed[name])
            if one is not None:
                found.append(one)
        if found and self.begun is None:
            at = min(int(one.at[0]) for one in found)
            self.begun = (piece.segment, int(piece.t_ns[at]))
            self.equal_before = self.rows + at
        for one in found:
            t_ns = int(piece.t_ns[one.at[0]])
            fresh = Parting(one.signal, piece.segment, t_ns, one.a, one.b)
            parting = self.by_signal.setdefault(one.signal, fresh)
            parting.grow(one, piece, self.begun or (0, 0))
        self.rows += len(piece.t_ns)
        if self.begun is None:
            self.equal_before = self.rows


def compare(
    a: Iterator[Log],
    b: Iterator[Log],
    tolerances: Sequence[tuple[str, float]] = (),
    see: Callable[[Shared, list[str]], None] | None = None,
) -> RecordingComparison:
    """Compare two recordings row by row, by segment and time.

    Parameters
    ----------
    a, b : iterator of Log
        Pieces of each recording, in order; a piece is dropped before the next one is read.
    tolerances : sequence of (pattern, float)
        Absolute differences that are none, in the signal's unit; the last pattern that fits counts.
    see : callable, optional
        Gets the rows that both have, a piece at a time, and the names of their common signals.

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
    parts = _Partings(names, allowances(names, tolerances))
    for piece in shared_rows(first, second):
        if see is not None:
            see(piece, names)
        parts.take(piece)
    if not parts.rows:
        raise LogError(
            "the recordings have no time in common; compare logs that begin at the same time"
        )

    signals = (head_a.run or {}).get("signals", ())
    only_in_a = sorted(head_a.columns.keys() - head_b.columns.keys())
    only_in_b = sorted(head_b.columns.keys() - head_a.columns.keys())
    by_time = sorted(parts.by_signal.values(), key=lambda p: (p.segment, p.t_ns))
    come_in = {s["name"] for s in signals if s["direction"] == "in"}
    inputs = frozenset(come_in.intersection(names))
    changes = changes_between(head_a.run, head_b.run)
    return RecordingComparison(
        signals=len(names),
        rows=parts.rows,
        equal_before=parts.equal_before,
        partings=by_time,
        inputs=inputs,
        alone=(first.alone, second.alone),
        only_in=(only_in_a, only_in_b),
        changes=changes,
    )


def allowances(
    names: Sequence[str], tolerances: Sequence[tuple[str, float]]
) -> dict[str, float]:
    """Return by how much each signal may differ; LogError if a pattern fits none."""
    allowed = dict.fromkeys(names, 0.0)
    for pattern, size in tolerances:
        fitting = [name for name in names if fnmatchcase(name, pattern)]
        if not fitting:
            hint = meant(pattern, names, "see 'hilserver signals'")
            raise LogError(f"--tolerance {pattern}: fits no signal of both; {hint}")
        allowed |= dict.fromkeys(fitting, size)
    return allowed


def differing(name: str, piece: Shared, allowed: float) -> Differing | None:
    """Return where and how much a signal differs; None where it does not."""
    a = piece.a.columns[name][piece.rows_of_a]
    b = piece.b.columns[name][piece.rows_of_b]
    if np.array_equal(a.view(np.int64), b.view(np.int64)):
        return None

    size = sizes(name, a, b)
    at = np.flatnonzero(size > allowed)
    if not len(at):
        return None
    of_a = float(a[at[0]])
    of_b = float(b[at[0]])
    return Differing(name, at, size[at], of_a, of_b)


def sizes(
    name: str, a: NDArray[np.float64], b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return by how much a signal differs in each row; angles take the shorter way round."""
    is_gap_a = np.isnan(a)
    is_gap_b = np.isnan(b)
    with np.errstate(invalid="ignore"):
        size = np.where(a == b, 0.0, np.abs(a - b))
    if _wraps(name):
        size = np.minimum(size, np.abs(2.0 * math.pi - size))
    size[is_gap_a & is_gap_b] = 0.0
    # A value beside none is the largest difference there is, whatever the tolerance.
    size[is_gap_a ^ is_gap_b] = math.inf
    return size


@cache
def _wraps(name: str) -> bool:
    signal = known_signals().get(name)
    return signal is not None and (signal.low, signal.high) == (-math.pi, math.pi)


def changes_between(
    a: Mapping[str, Any] | None, b: Mapping[str, Any] | None
) -> list[OriginChange]:
    """Return what differs between two runs; nothing for logs of others, which do not say."""
    if a is None or b is None:
        return []
    entries_a = dict(_entries(a))
    entries_b = dict(_entries(b))
    keys = [*entries_a, *(key for key in entries_b if key not in entries_a)]
    return [
        OriginChange(key, entries_a.get(key, _ABSENT), entries_b.get(key, _ABSENT))
        for key in keys
        if entries_a.get(key) != entries_b.get(key)
    ]


def _entries(run: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    for key in _OF_THE_RUN:
        yield key, f"{run.get(key)}"
    try:
        configuration = configuration_of(run)
    except ValueError:
        return
    yield from _flat(configuration)


def _flat(node: Any, key: str = "") -> Iterator[tuple[str, str]]:
    if not isinstance(node, Mapping):
        yield key, f"{node}"
        return
    for name, inner in node.items():
        yield from _flat(inner, f"{key}.{name}" if key else str(name))
