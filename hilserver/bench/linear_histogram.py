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


def ratio_interval(
    blocks: Sequence[NDArray[np.int64]], reference: Sequence[NDArray[np.int64]], percent: float
) -> tuple[float, float]:
    """Return the 95 % interval of the ratio of the medians over the blocks.

    Percentile bootstrap over the blocks (2000 draws, fixed seed): how far the ratio would move if
    the same computer were measured again. A wide interval says that the tail is the computer's.
    """
    ours = np.array([percentile_us(block, percent) for block in blocks])
    theirs = np.array([percentile_us(block, percent) for block in reference])
    rng = np.random.default_rng(0)
    draws = 2000
    medians = np.median(ours[rng.integers(len(ours), size=(draws, len(ours)))], axis=1)
    others = np.median(theirs[rng.integers(len(theirs), size=(draws, len(theirs)))], axis=1)
    low, high = np.percentile(medians / np.maximum(others, 1.0), [2.5, 97.5])
    return float(low), float(high)


def sparse(counts: NDArray[np.int64]) -> dict[str, int]:
    """Return the bins that are not empty: latency [us] -> count."""
    return {str(i): int(counts[i]) for i in np.flatnonzero(counts)}
