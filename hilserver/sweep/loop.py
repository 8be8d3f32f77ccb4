"""Many ticks of one machine: the compiled step without published frames, clock or statistics."""

from typing import Any

import numpy as np
from numba.core import types
from numpy.typing import NDArray

from hilserver.compiled import kernel
from hilserver.image import word
from hilserver.scheduler import faults
from hilserver.scheduler.law import is_due
from hilserver.scheduler.step import FAULT, LATCH, PUBLISH, STEP_TYPE

_ARGUMENTS = (
    STEP_TYPE,
    types.int64[::1],
    types.int64,
    types.int64,
    types.int64,
    types.int64[::1],
    types.float64[:, ::1],
    types.float64[::1],
    types.int64[::1],
)


@kernel(types.int64(*_ARGUMENTS))
def run_ticks(
    step: Any,
    periods: NDArray[np.int64],
    period_ns: int,
    first: int,
    n_ticks: int,
    slots: NDArray[np.int64],
    kept: NDArray[np.float64],
    values: NDArray[np.float64],
    words: NDArray[np.int64],
) -> int:
    """Run ticks in the order of every pacing back end; return the first fault number, 0 if none.

    Parameters
    ----------
    step : STEP_TYPE
        The compiled step.
    periods : ndarray of int64
        Periods of the compiled slices [ticks].
    slots : ndarray of int64, shape (k,)
        Signals to keep.
    kept : ndarray of float64, shape (k, n)
        Receives their values, one column per tick of the drive, from 0 on.
    """
    for tick in range(first, first + n_ticks):
        planned_ns = tick * period_ns
        step(LATCH, tick, planned_ns, values, words)
        fault = 0
        for index in range(periods.shape[0]):
            if is_due(tick, periods[index]):
                answer = step(index, tick, planned_ns, values, words)
                if fault == 0:
                    fault = answer
        step(PUBLISH, tick, planned_ns, values, words)
        frame = words[word.FRAME_BASE]
        for i in range(slots.shape[0]):
            kept[i, tick] = values[frame + slots[i]]
        if fault != 0:
            step(FAULT, faults.SLICE + fault, planned_ns, values, words)
            return int(fault)
    return 0
