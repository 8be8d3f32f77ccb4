"""The compiled step that the scheduler drives, and the order of its phases.

The scheduler does not know the plant: it calls one compiled function by phase. In every tick, in
every pacing back end, the order is the same::

    LATCH -> slice 0 (if due) -> slice 1 (if due) -> ... -> PUBLISH

and, only if a limit was exceeded or a slice reported a fault, ``FAULT`` after ``PUBLISH``.
"""

from collections.abc import Callable
from typing import Any

import numpy as np
from numba.core import types
from numpy.typing import NDArray

LATCH = -1
"""Take the inputs; return the number of the tick to execute now (a different one after a restore).
Called at every wake-up, also while paused."""
PUBLISH = -2
"""Publish the outputs of this tick; return 0. Also called for the last tick of a state that was
restored while paused."""
# enter the safe state; ``tick`` carries the code, see `hilserver.scheduler.faults`
FAULT = -3

STEP_SIGNATURE: Any = types.int64(
    types.int64, types.int64, types.int64, types.float64[::1], types.int64[::1]
)
"""``(phase, tick, planned_ns, values, words)``; decorate with ``kernel(STEP_SIGNATURE)``."""

STEP_TYPE: Any = types.FunctionType(STEP_SIGNATURE)

StepFunction = Callable[[int, int, int, NDArray[np.float64], NDArray[np.int64]], int]
