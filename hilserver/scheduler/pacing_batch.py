"""A batch of ticks in virtual time."""

from typing import Any

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from hilserver.compiled import kernel
from hilserver.scheduler.turn import I8, RAN, TURN_ARGUMENTS, turn


@kernel(types.int64(*TURN_ARGUMENTS, I8, types.int64))
def run_batch(
    step: Any,
    law: NDArray[np.int64],
    control: NDArray[np.int64],
    slices: NDArray[np.int64],
    stats: NDArray[np.int64],
    comm: NDArray[np.int64],
    ring: NDArray[np.int64],
    values: NDArray[np.float64],
    words: NDArray[np.int64],
    scratch: NDArray[np.int64],
    n_ticks: int,
) -> int:
    """Run at most `n_ticks`; return early, with the flags of `turn`, when there is news."""
    flags = 0
    for _ in range(n_ticks):
        flags = turn(step, law, control, slices, stats, comm, ring, values, words, scratch, True)
        if flags != RAN:
            break
    return flags
