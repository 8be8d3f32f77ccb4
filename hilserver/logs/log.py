"""The content of a log, whatever file it came from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class RecordedState:
    """A state in the middle of a recording, from which it can be replayed."""

    # the state before this tick of this segment
    segment: int
    tick: int
    words: NDArray[np.int64]  # shape (n,); the live regions of the process image


@dataclass(frozen=True, slots=True)
class Change:
    """Parameters that changed in a recording, from a tick on."""

    # the first tick with them
    segment: int
    tick: int
    number: int  # value of ``internal.edition`` from then on
    values: Mapping[str, float]  # every parameter by name; NaN is null
    packed: NDArray[np.float64]  # shape (n,); what the plant continued with


@dataclass(frozen=True)
class Log:
    """A table with a time column and any subset of the signals."""

    path: Path
    t_s: NDArray[np.float64]  # shape (n,); time of each row [s]; rises within a segment
    # shape (n,); between two segments the robot's pose starts anew
    segment: NDArray[np.int64]
    # shape (n,); signal name to values; NaN where there is no sample
    columns: Mapping[str, NDArray[np.float64]]
    block: NDArray[np.int64] | None = None  # shape (n,); unit of held-out splits
    # shape (n,); OPC UA status codes; empty if the file has none
    status: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    # version, configuration, kernels ... of the run; None for a log that is not ours
    run: Mapping[str, Any] | None = None
    states: Sequence[RecordedState] = ()
    changes: Sequence[Change] = ()
    notices: Sequence[str] = ()  # what a reader should know: rows dropped, frames lost

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def is_ours(self) -> bool:
        """Whether hilserver wrote it and its run is known."""
        return self.run is not None

    def ticks(self, base_period_ns: int, start_s: float = 0.0) -> NDArray[np.int64]:
        """Return the first tick at or after each row, counted from `start_s` on, shape (n,)."""
        exact = (self.t_s - start_s) * (NS_PER_S / base_period_ns)
        return np.asarray(np.ceil(exact - 1e-3), dtype=np.int64)
