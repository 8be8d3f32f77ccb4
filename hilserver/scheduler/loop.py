"""The data of the pacing loop: one record, passed whole to every compiled part."""

from typing import Any, NamedTuple

import numpy as np
from numba.core import types
from numba.core.types.containers import NamedTuple as RecordType
from numpy.typing import NDArray

from hilserver.scheduler.step import STEP_TYPE

# Compiled slices: one row each
S_PERIOD_TICKS, S_START, S_END, S_DUE = range(4)
N_SLICE = 4

# Scratch: timespec, the doorbell's 1, struct rusage, and its values at the end of the last tick
TIMESPEC, ONE, RUSAGE, PREVIOUS = 0, 2, 4, 24
N_SCRATCH = 32


class Loop(NamedTuple):
    """The arrays of one scheduler's loop; none is replaced while it runs."""

    law: NDArray[np.int64]  # see `law`
    control: NDArray[np.int64]  # see `exchange`, as for `comm` and `ring`
    slices: NDArray[np.int64]  # shape (compiled slices, N_SLICE)
    stats: NDArray[np.int64]  # see `statistics_rows`
    comm: NDArray[np.int64]
    ring: NDArray[np.int64]
    values: NDArray[np.float64]  # passed through to the step, like `words`
    words: NDArray[np.int64]
    scratch: NDArray[np.int64]  # shape (N_SCRATCH,)


I8 = types.int64[::1]
_TABLE = types.int64[:, ::1]
LOOP_TYPE: Any = RecordType(
    (I8, I8, _TABLE, I8, I8, _TABLE, types.float64[::1], I8, I8), Loop
)
TURN_ARGUMENTS: Any = (STEP_TYPE, LOOP_TYPE)
