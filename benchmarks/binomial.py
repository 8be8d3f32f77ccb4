"""The uncertainty of a share: exact interval of a binomial proportion."""

from scipy.stats import beta


def clopper_pearson(
    count: int, trials: int, confidence: float = 0.95
) -> tuple[float, float]:
    """Return the exact interval of a share (Clopper and Pearson 1934); (0, 1) without trials."""
    tail = (1.0 - confidence) / 2.0
    low = float(beta.ppf(tail, count, trials - count + 1)) if count > 0 else 0.0
    high = float(beta.isf(tail, count + 1, trials - count)) if count < trials else 1.0
    return low, high
