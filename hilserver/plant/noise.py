"""Random numbers without a hidden state: a hash of seed, counter and channel.

The same seed and counter give the same number in every pacing back end, and a restored snapshot
continues the same series.
"""

import math

import numpy as np

from hilserver.compiled import inlined, kernel

_GOLDEN = np.uint64(0x9E3779B97F4A7C15)
_MIX_1 = np.uint64(0xBF58476D1CE4E5B9)
_MIX_2 = np.uint64(0x94D049BB133111EB)
_S30, _S27, _S31, _S11 = np.uint64(30), np.uint64(27), np.uint64(31), np.uint64(11)
_ULP = 2.0**-53


@inlined
def _mix(word: np.uint64) -> np.uint64:
    """Return the word with its bits mixed (the finaliser of splitmix64)."""
    word = word + _GOLDEN
    word = (word ^ (word >> _S30)) * _MIX_1
    word = (word ^ (word >> _S27)) * _MIX_2
    return word ^ (word >> _S31)


# Seeds and counters come as floats of the plant and as integers of a modifier: one form for both.
_SIGNATURE = "float64(int64, int64, int64)"


@kernel(_SIGNATURE, _nrt=False)
def uniform(seed: float, counter: float, channel: int) -> float:
    """Return a number in (0, 1) that depends on the three arguments alone."""
    word = _mix(_mix(_mix(np.uint64(seed)) + np.uint64(counter)) + np.uint64(channel))
    return (float(word >> _S11) + 0.5) * _ULP


@kernel(_SIGNATURE, _nrt=False)
def normal(seed: float, counter: float, channel: int) -> float:
    """Return a standard normal number (Box and Muller); channels 2 c and 2 c + 1 are used."""
    radius = math.sqrt(-2.0 * math.log(uniform(seed, counter, 2 * channel)))
    return radius * math.cos(2.0 * math.pi * uniform(seed, counter, 2 * channel + 1))
