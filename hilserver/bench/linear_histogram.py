"""Linear histograms in bins of 1 us, as cyclictest prints them: percentiles and a short form."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

PERCENTILES = (50.0, 99.0, 99.9)


def percentile_us(counts: NDArray[np.int64], percent: float) -> float:
    """Return the smallest latency [us] that `percent` % of the samples do not exceed.

    Bin i holds latencies of i to i + 1 us; the last bin holds what is longer. NaN without samples.
    """
    total = int(counts.sum())
    if total == 0:
        return float("nan")
    rank = -(-total * round(percent * 1000) // 100_000)  # rounded up, in integers
    return float(np.searchsorted(np.cumsum(counts), max(rank, 1)))


def median_of_blocks_us(blocks: Sequence[NDArray[np.int64]], percent: float) -> float:
    """Return the median over the blocks of each block's percentile [us]."""
    return float(np.median([percentile_us(block, percent) for block in blocks]))


def sparse(counts: NDArray[np.int64]) -> dict[str, int]:
    """Return the bins that are not empty: latency [us] -> count."""
    return {str(i): int(counts[i]) for i in np.flatnonzero(counts)}
