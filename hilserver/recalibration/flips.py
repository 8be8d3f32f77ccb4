"""Does one model explain a window better than another? A test by flipping signs of blocks.

Both models are fixed before the window is seen. If the running one is right, the other is off by
some d, and the difference of a block's deviances is 2 <noise, d> - <d, d>: symmetric about a value
not above zero. A sum that only a share `p` of all flips reaches therefore has a probability of at
most `p`, whatever the noise within a block is like.
"""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

# With this sum of squares the right model gains 43 +- 13: significant at 0.05 in 95 % of windows.
ENOUGH_SHOWN: Final = 43.0
# of the mean of all blocks; signs of smaller differences are noise
QUIET_SHARE: Final = 0.1
MOST_FLIPS: Final = 200_000
_AT_ONCE: Final = 4096


@dataclass(frozen=True)
class FlipTest:
    """Result of the test."""

    p: float
    resolution: float  # the smallest p that so many blocks and flips can show
    blocks: int

    def resolves(self, level: float) -> bool:
        """Whether so few blocks can be significant at this level at all."""
        return self.resolution <= level

    def holds(self, level: float) -> bool:
        """Whether the other model is better, at this level."""
        return self.resolves(level) and self.p <= level


def seen(differences: Array, shown: Array) -> Array:
    """Return differences for `gains`, with 0 in blocks where the models hardly differ.

    While the robot stands still they differ by next to nothing, and noise would decide.

    Parameters
    ----------
    shown : ndarray, shape (blocks,)
        Sum of squares of the whitened difference of the two models.
    """
    quiet = QUIET_SHARE * np.nansum(shown) / max(len(shown), 1)
    counted = shown >= quiet
    is_enough = float(shown[counted].sum()) >= ENOUGH_SHOWN
    return np.where(counted & is_enough, differences, 0.0)


def gains(differences: Array, rng: np.random.Generator) -> FlipTest:
    """Test whether the deviance falls: one-sided, by flipped signs.

    Parameters
    ----------
    differences : ndarray, shape (blocks,)
        Deviance of each block before minus after.
    """
    counted = differences[np.isfinite(differences) & (differences != 0.0)]
    n = len(counted)
    if n == 0:
        return FlipTest(1.0, 1.0, 0)
    # the same signs in another order differ by rounding
    rounding = 1e-12 * float(np.abs(counted).sum())
    least = float(counted.sum()) - rounding
    if 2**n <= MOST_FLIPS:
        bits = np.arange(2**n)[:, None] >> np.arange(n)
        signs = 1.0 - 2.0 * (bits & 1)
        reached = int(np.count_nonzero(signs @ counted >= least))
        return FlipTest(reached / 2**n, 0.5**n, n)
    reached = done = 0
    while done < MOST_FLIPS:
        signs = 1.0 - 2.0 * rng.integers(0, 2, size=(_AT_ONCE, n))
        reached += int(np.count_nonzero(signs @ counted >= least))
        done += _AT_ONCE
    return FlipTest((reached + 1) / (done + 1), 1.0 / (done + 1), n)


def fewest_blocks(level: float) -> int:
    """Return how many blocks a test at this level needs."""
    return math.ceil(math.log2(1.0 / level))
