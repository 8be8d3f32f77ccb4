"""Everything that one scheduler's loop works on: the compiled step and its arrays."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from hilserver.scheduler.exchange import Exchange
from hilserver.scheduler.law import WARM_UP_LEFT, law_array
from hilserver.scheduler.loop import N_SCRATCH, N_SLICE, S_PERIOD_TICKS, Loop
from hilserver.scheduler.policies import OverrunLimits, OverrunPolicy
from hilserver.scheduler.slices import Slice, check_slices
from hilserver.scheduler.statistics import Statistics
from hilserver.scheduler.step import StepFunction
from hilserver.scheduler.turn import turn


class Machine:
    """The loop's arrays; the pacing back ends differ only in when they call `turn`.

    Its slices of each kind are in the order of the statistics' rows.
    """

    def __init__(
        self,
        *,
        base_period_ns: int,
        slices: Sequence[Slice],
        step: StepFunction,
        values: NDArray[np.float64],
        words: NDArray[np.int64],
        policy: OverrunPolicy,
        limits: OverrunLimits,
        warm_up_ticks: int,
        first_tick: int,
        statistics_array: NDArray[np.int64] | None,
        linear_bins: int,
    ) -> None:
        _check_types(step, values, words)
        self.base_period_ns = base_period_ns
        self.compiled, self.communication = check_slices(slices)
        self.law = law_array(base_period_ns, policy, limits, warm_up_ticks, first_tick)
        periods = [part.period_ticks for part in self.communication]
        self.exchange = Exchange(base_period_ns, periods, first_tick)
        self.statistics = Statistics(
            [*self.compiled, *self.communication],
            base_period_ns,
            statistics_array,
            linear_bins,
        )
        table = np.zeros((len(self.compiled), N_SLICE), dtype=np.int64)
        table[:, S_PERIOD_TICKS] = [part.period_ticks for part in self.compiled]
        self.step = step
        self.loop = Loop(
            self.law,
            self.exchange.control,
            table,
            self.statistics.array,
            self.exchange.comm,
            self.exchange.ring,
            values,
            words,
            np.zeros(N_SCRATCH, dtype=np.int64),
        )

    def turn(self, *, virtual: bool) -> int:
        """Do what is due now; return the flags of `turn.turn`."""
        return int(turn(self.step, self.loop, virtual))

    @property
    def warming_up(self) -> bool:
        """True while ticks are not counted yet."""
        return bool(self.law[WARM_UP_LEFT] > 0)

    def prefault(self) -> None:
        """Touch every page of every array once, without changing a bit."""
        for array in self.loop:  # 512 words are a page
            array.reshape(-1).view(np.int64)[::512] += 0


def _check_types(
    step: StepFunction, values: NDArray[np.float64], words: NDArray[np.int64]
) -> None:
    """Refuse here, with a message, what compiled code would refuse in its own thread."""
    if not getattr(step, "nopython_signatures", None):
        raise TypeError("the step must be compiled with kernel(STEP_SIGNATURE)")
    for name, array, kind in (
        ("values", values, np.float64),
        ("words", words, np.int64),
    ):
        if array.dtype != kind or array.ndim != 1 or not array.flags.c_contiguous:
            raise TypeError(f"{name} must be a flat contiguous {np.dtype(kind)} array")
