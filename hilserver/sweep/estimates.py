"""Estimates about all machines, with intervals: shares, rank correlations, pairs."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy import stats

from hilserver.arrays import Array

LEVEL: Final = 0.95
LEAST_MACHINES: Final = 10  # with fewer machines no correlation is reported
# rank correlation above which two drawn parameters form one group
TOGETHER: Final = 0.7


def exact_interval(passed: int, n: int) -> tuple[float, float]:
    """Return the interval of Clopper and Pearson for a share; it covers at least `LEVEL`."""
    if n == 0:
        return 0.0, 1.0
    found = stats.binomtest(passed, n).proportion_ci(LEVEL, method="exact")
    return float(found.low), float(found.high)


@dataclass(frozen=True)
class Influence:
    """How much one parameter, or a group that is drawn together, decides a margin."""

    # several if their draws are so correlated that the sweep cannot separate them
    names: tuple[str, ...]
    # Spearman's, of the first name; positive if it raises the margin
    rank_correlation: float
    # 95 % (Fisher's z with the variance of Bonett and Wright, 2000)
    interval: tuple[float, float]
    # 0 .. 1: share of the variance of the margin's ranks that the parameter explains, in any shape;
    # influences are sorted by it
    strength: float


def influences(parameters: dict[str, Array], margin: Array) -> list[Influence]:
    """Return what decides a margin, strongest first."""
    fine = ~np.isnan(margin)
    if fine.sum() < LEAST_MACHINES:
        return []
    ranks = stats.rankdata(margin[fine])
    drawn = {
        n: stats.rankdata(v[fine])
        for n, v in parameters.items()
        if np.ptp(v[fine]) > 0.0
    }
    found = []
    for name, values in drawn.items():
        r = _correlation(values, ranks)
        found.append(
            Influence((name,), r, _fisher(r, len(ranks)), explained(values, ranks))
        )
    found.sort(key=lambda item: -item.strength)
    # Parameters whose draws are correlated are a group; the strongest one represents it.
    groups: list[Influence] = []
    for one in found:
        (own,) = one.names
        for k, group in enumerate(groups):
            alike = (
                abs(_correlation(drawn[own], drawn[other])) for other in group.names
            )
            if max(alike) > TOGETHER:
                names = (*group.names, own)
                groups[k] = Influence(
                    names, group.rank_correlation, group.interval, group.strength
                )
                break
        else:
            groups.append(one)
    return groups


def explained(values: Array, ranks: Array) -> float:
    """Return the share of the variance of `ranks` between slices of `values`, minus chance.

    A parameter that hurts at both ends has no rank correlation; its slices show it.
    """
    n = len(ranks)
    n_slices = int(min(max(math.sqrt(n) / 2.0, 2.0), 20.0))
    total = float(((ranks - ranks.mean()) ** 2).sum())
    if total == 0.0:
        return 0.0
    slices = np.array_split(np.argsort(values, kind="stable"), n_slices)
    between = sum(
        len(s) * (float(ranks[s].mean()) - float(ranks.mean())) ** 2 for s in slices
    )
    by_chance = (n_slices - 1) / (n - 1)
    return max((between / total - by_chance) / (1.0 - by_chance), 0.0)


def _correlation(a: Array, b: Array) -> float:
    a = a - a.mean()
    b = b - b.mean()
    of_a = float((a**2).sum())
    of_b = float((b**2).sum())
    size = math.sqrt(of_a * of_b)
    if size > 0.0:
        return float((a * b).sum()) / size
    return 0.0


def _fisher(r: float, n: int) -> tuple[float, float]:
    if n <= 3 or abs(r) >= 1.0:
        if abs(r) >= 1.0:
            return (r, r)
        return (-1.0, 1.0)
    spread = 1.0 + r * r / 2.0
    width = 1.96 * math.sqrt(spread / (n - 3))
    high = math.atanh(r) + width
    low = math.atanh(r) - width
    return math.tanh(low), math.tanh(high)


def median_interval(values: Array) -> tuple[float, float, float]:
    """Return the median and its exact interval from order statistics."""
    ordered = np.sort(values)
    n = len(ordered)
    k = int(stats.binom.ppf((1.0 - LEVEL) / 2.0, n, 0.5))
    low = max(k - 1, 0)
    high = min(n - k, n - 1)
    return float(np.median(ordered)), float(ordered[low]), float(ordered[high])


def paired_p(only_first: int, only_second: int) -> float:
    """Return the probability of counts at least this uneven by chance (exact test of McNemar)."""
    n = only_first + only_second
    if n == 0:
        return 1.0
    return float(stats.binomtest(only_first, n, 0.5).pvalue)
