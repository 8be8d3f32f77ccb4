"""Where one signal is not the same in the rows that two recordings share."""

import math
from collections.abc import Sequence
from fnmatch import fnmatchcase
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilserver.comparison.rows import Shared
from hilserver.errors import LogError, meant
from hilserver.measured.names import known_signals


class Differing(NamedTuple):
    """The rows of a piece in which a signal differs, and both values in the first of them."""

    signal: str
    at: NDArray[np.intp]  # shape (n,)
    size: NDArray[np.float64]  # shape (n,)
    a: float
    b: float


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

    is_gap_a = np.isnan(a)
    is_gap_b = np.isnan(b)
    with np.errstate(invalid="ignore"):
        size = np.where(a == b, 0.0, np.abs(a - b))
    if _wraps(name):
        size = np.minimum(size, np.abs(2.0 * math.pi - size))
    size[is_gap_a & is_gap_b] = 0.0
    # A value beside none is the largest difference there is, whatever the tolerance.
    size[is_gap_a ^ is_gap_b] = math.inf
    at = np.flatnonzero(size > allowed)
    if not len(at):
        return None
    of_a = float(a[at[0]])
    of_b = float(b[at[0]])
    return Differing(name, at, size[at], of_a, of_b)


@cache
def _wraps(name: str) -> bool:
    signal = known_signals().get(name)
    return signal is not None and (signal.low, signal.high) == (-math.pi, math.pi)
