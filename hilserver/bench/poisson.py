"""Are two rates of rare events the same? Exact conditional interval, and bootstrap over blocks."""

import math
from collections.abc import Callable, Sequence

import numpy as np

_RESAMPLES = 4000


def rate_ratio_interval(
    count: int, time_s: float, reference: int, reference_s: float, confidence: float = 0.95
) -> tuple[float, float]:
    """Return the interval of the ratio of two Poisson rates.

    Given the sum of both counts, the first is binomial with p = r t / (r t + t_ref), r the ratio;
    the bounds are those of Clopper and Pearson (Przyborowski and Wilenski 1940).

    Returns
    -------
    low, high : float
        0 and infinity where the counts tell nothing.
    """
    total = count + reference
    alpha = (1 - confidence) / 2
    low = 0.0 if count == 0 else _solve(lambda p: _at_least(count, total, p) - alpha)
    high = 1.0 if reference == 0 else _solve(lambda p: alpha - _at_most(count, total, p))
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

    It holds for events in bursts, as long as one block tells nothing of the next. Half an event is
    added to both counts: a resample without any has a ratio, too (percentile interval of Efron and
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


def _at_most(k: int, n: int, p: float) -> float:
    return math.fsum(_binomial(i, n, p) for i in range(k + 1))


def _at_least(k: int, n: int, p: float) -> float:
    return math.fsum(_binomial(i, n, p) for i in range(k, n + 1))


def _binomial(k: int, n: int, p: float) -> float:
    if p in (0.0, 1.0):
        return float(k == (n if p else 0))
    log = math.lgamma(n + 1) - math.lgamma(k + 1) - math.lgamma(n - k + 1)
    return math.exp(log + k * math.log(p) + (n - k) * math.log1p(-p))


def _solve(increasing: Callable[[float], float]) -> float:
    low, high = 0.0, 1.0
    for _ in range(60):
        middle = (low + high) / 2
        if increasing(middle) < 0:
            low = middle
        else:
            high = middle
    return (low + high) / 2
