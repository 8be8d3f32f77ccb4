"""Ratio of two rates of rare events: exact conditional interval, and bootstrap over blocks."""

import math
from collections.abc import Sequence

import numpy as np

from benchmarks.binomial import clopper_pearson

_RESAMPLES = 4000


def rate_ratio_interval(
    count: int,
    time_s: float,
    reference: int,
    reference_s: float,
    confidence: float = 0.95,
) -> tuple[float, float]:
    """Return the interval of the ratio of two Poisson rates.

    Given the sum of both counts, the first is binomial with p = r t / (r t + t_ref), r the ratio;
    the bounds are those of Clopper and Pearson (Przyborowski and Wilenski 1940).

    Returns
    -------
    low, high : float
        0 and infinity if the counts contain no information.
    """
    low, high = clopper_pearson(count, count + reference, confidence)
    scale = reference_s / time_s

    def ratio(p: float) -> float:
        return math.inf if p >= 1 else p / (1 - p) * scale

    return ratio(low), ratio(high)


def block_ratio_interval(
    blocks: Sequence[tuple[int, float]],
    reference: Sequence[tuple[int, float]],
    confidence: float = 0.95,
) -> tuple[float, float]:
    """Return the interval of the ratio of two rates by a bootstrap over blocks.

    It holds for events in bursts, as long as blocks are independent. Half an event is added to both
    counts, so that a resample without events has a ratio too (percentile interval of Efron and
    Tibshirani 1993).

    Parameters
    ----------
    blocks, reference : sequence of (int, float)
        Events in a block and its length [s].
    """
    rng = np.random.default_rng(0)
    rates = []
    for rows in (blocks, reference):
        table = np.array(rows, dtype=np.float64)
        drawn = table[rng.integers(0, len(table), (_RESAMPLES, len(table)))].sum(axis=1)
        rates.append((drawn[:, 0] + 0.5) / drawn[:, 1])
    tail = 50 * (1 - confidence)
    low, high = np.percentile(rates[0] / rates[1], [tail, 100 - tail])
    return float(low), float(high)
