"""A step that does nothing, which leaves the pacing itself."""

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled import kernel
from hilserver.scheduler.step import LATCH, STEP_SIGNATURE


@kernel(STEP_SIGNATURE)
def empty_step(
    phase: int,
    tick: int,
    planned_ns: int,  # noqa: ARG001 - the signature is the scheduler's
    values: NDArray[np.float64],  # noqa: ARG001
    words: NDArray[np.int64],  # noqa: ARG001
) -> int:
    """Return the tick unchanged; report no fault."""
    return tick if phase == LATCH else 0
