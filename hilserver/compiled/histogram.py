"""Fixed 1-2-5 histograms of int64 counts: filled in kernels, exported without conversion.

The bounds run from 1 us to 10 s; a value counts in the first bucket whose upper bound is not below
it, values above 10 s in the last bucket.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.cache import inlined

BOUNDS_NS: NDArray[np.int64] = np.array(
    [m * 10**e for e in range(3, 10) for m in (1, 2, 5)] + [10**10], dtype=np.int64
)
N_BUCKETS = len(BOUNDS_NS) + 1


@inlined
def bucket_index(value_ns: int) -> int:
    """Return the bucket, 0 .. ``N_BUCKETS - 1``, of a duration in ns (negative counts as 0)."""
    for index in range(BOUNDS_NS.shape[0]):
        if value_ns <= BOUNDS_NS[index]:
            return index
    return int(BOUNDS_NS.shape[0])


class Histogram125:
    """A duration histogram filled from Python, in the same form as in kernels."""

    def __init__(self) -> None:
        # shape (N_BUCKETS,); count per bucket, not cumulated
        self.counts = np.zeros(N_BUCKETS, dtype=np.int64)
        self.sum_ns = 0  # sum of all observed durations
        self.last_ns: int | None = None  # the newest observation

    def observe(self, value_ns: int) -> None:
        """Count one duration [ns]."""
        self.counts[int(np.searchsorted(BOUNDS_NS, value_ns))] += 1
        self.sum_ns += value_ns
        self.last_ns = value_ns

    @property
    def count(self) -> int:
        """Number of observations."""
        return int(self.counts.sum())

    def clear(self) -> None:
        """Reset all counts."""
        self.counts[:] = 0
        self.sum_ns = 0
        self.last_ns = None


__all__: list[Any] = ["BOUNDS_NS", "N_BUCKETS", "Histogram125", "bucket_index"]
