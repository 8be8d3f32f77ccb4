"""Whether the gap between measured and simulated has left its usual range.

One principle for all channels: blocks of some seconds, each with the logarithm of the gap's mean
square, and a two-sample test of the newest blocks against those before. The logarithm turns a
larger gap of either sign into a shift, whatever the channel's unit. The scatter of the earlier
blocks defines what is usual, their autocorrelation how much evidence they are.
"""

import math
from collections import deque
from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtr

GAP_BLOCK_S: Final = 10.0
# over which the change of an integral (position, heading) is compared
STRIDE_S: Final = 1.0
NEWEST: Final = (3, 6, 12, 24)  # ages of the change that are tested [blocks]
FEWEST_USUAL: Final = 12
MOST_BLOCKS: Final = 720
ALARM_EVERY_S: Final = 30 * 86400.0  # mean time between false alarms
LEAST_MOVED: Final = 0.5
"""Share of a block in which the robot must move: at rest every model is right."""
LEAST_SQUARE: Final = 1e-12
LARGEST_GAP: Final = 1e9
"""Larger than any sensor of a robot shows, in any unit; keeps the square finite."""
HEADINGS: Final = ("pose.yaw_rad", "nav.yaw_rad", "imu.yaw_rad")
POSITIONS: Final = (("pose.x_m", "pose.y_m"), ("nav.x_m", "nav.y_m"))
_INTEGRALS: Final = {*HEADINGS, *(name for pair in POSITIONS for name in pair)}

Values = Mapping[str, float]


class Residuals:
    """Sums up the gap in blocks, one number per channel."""

    def __init__(self, block_s: float = GAP_BLOCK_S) -> None:
        self._block_s = block_s
        self._begun_s = math.inf
        self._before: tuple[float, Values, Values] | None = None
        self._squares: dict[str, list[float]] = {}
        self._moved = self._seen = 0

    def take(
        self, t_s: float, measured: Values, simulated: Values, *, moves: bool
    ) -> Values:
        """Take the measured and simulated values of one instant.

        Returns
        -------
        mapping of str to float
            By channel when a block is complete, else empty.
        """
        if t_s < self._begun_s:
            self._restart(t_s)
        shared = measured.keys() & simulated.keys()
        for name in shared - _INTEGRALS:
            self._squares.setdefault(name, []).append(
                _square(measured[name] - simulated[name])
            )
        self._stride(t_s, measured, simulated)
        self._seen += 1
        self._moved += moves
        if t_s - self._begun_s < self._block_s:
            return {}
        is_driven = self._moved >= LEAST_MOVED * self._seen
        means = {
            name: sum(own) / len(own) for name, own in self._squares.items() if own
        }
        self._restart(t_s)
        if is_driven:
            return {n: math.log(mean + LEAST_SQUARE) for n, mean in means.items()}
        return {}

    def _restart(self, t_s: float) -> None:
        self._begun_s = t_s
        self._squares = {}
        self._moved = self._seen = 0

    def _stride(self, t_s: float, measured: Values, simulated: Values) -> None:
        if self._before is None or not 0.0 <= t_s - self._before[0] < 2.0 * STRIDE_S:
            self._before = (t_s, dict(measured), dict(simulated))
            return
        then_s, *both = self._before
        if t_s - then_s < STRIDE_S:
            return
        self._before = (t_s, dict(measured), dict(simulated))
        now = (measured, simulated)
        for name in HEADINGS:
            if all(name in values for values in (*both, *now)):
                of_robot, of_model = (
                    a[name] - b[name] for a, b in zip(now, both, strict=True)
                )
                gap = math.remainder(of_robot - of_model, math.tau)
                self._squares.setdefault(name, []).append(_square(gap))
        for x, y in POSITIONS:
            if all({x, y} <= values.keys() for values in (*both, *now)):
                of_robot, of_model = (
                    math.hypot(a[x] - b[x], a[y] - b[y])
                    for a, b in zip(now, both, strict=True)
                )
                self._squares.setdefault(x, []).append(_square(of_robot - of_model))


def _square(gap: float) -> float:
    return min(abs(gap), LARGEST_GAP) ** 2


class ChangeDetector:
    """Compares the newest blocks with earlier ones of the same model."""

    def __init__(self, block_s: float = GAP_BLOCK_S) -> None:
        self._level = block_s / ALARM_EVERY_S
        self._blocks: deque[Values] = deque(maxlen=MOST_BLOCKS)

    def restart(self) -> None:
        """Forget what was usual."""
        self._blocks.clear()

    def take(self, block: Values) -> str | None:
        """Take a block; return the channel whose gap has grown, None if all are as usual."""
        if not block:
            return None
        self._blocks.append(block)
        names = [n for n in block if all(n in one for one in self._blocks)]
        if not names:
            return None
        rows = np.array([[one[n] for n in names] for one in self._blocks])
        p = np.stack([grown(rows, n) for n in NEWEST])
        least = int(np.argmin(p.min(axis=0)))
        changed = p.min() * p.size < self._level
        return names[least] if changed else None


def grown(rows: NDArray[np.float64], newest: int) -> NDArray[np.float64]:
    """Return p values, one per column, for its last `newest` rows being no larger than the others.

    Student's test of two samples. Successive rows are correlated: a sample of n counts as
    n (1 - r) / (1 + r), with r the first autocorrelation of the earlier rows.

    Parameters
    ----------
    rows : ndarray, shape (n, k)
    """
    usual = rows[:-newest]
    late = rows[-newest:]
    n = len(usual)
    if n < FEWEST_USUAL:
        return np.ones(rows.shape[1])
    away = usual - usual.mean(axis=0)
    variance = (away**2).sum(axis=0) / (n - 1)
    safe = np.maximum(variance, LEAST_SQUARE)
    products = (away[1:] * away[:-1]).sum(axis=0)
    unbiased = products / ((n - 1) * safe) + 1.0 / n
    r = np.clip(unbiased, 0.0, 0.95)
    worth = (1.0 - r) / (1.0 + r)
    freedom = np.maximum(n * worth - 1.0, 1.0)
    scatter = np.sqrt(safe / worth * (1.0 / newest + 1.0 / n))
    rise = late.mean(axis=0) - usual.mean(axis=0)
    return np.asarray(stdtr(freedom, -rise / scatter))
