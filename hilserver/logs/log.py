"""What is in a log, whatever file it came from."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

NS_PER_S = 1_000_000_000


@dataclass(frozen=True, slots=True)
class State:
    """A state in the middle of a recording, from which it can be replayed.

    Attributes
    ----------
    segment, tick : int
        The state before this tick of this segment.
    words : ndarray of int64, shape (n,)
        The live regions of the process image.
    """

    segment: int
    tick: int
    words: NDArray[np.int64]


@dataclass(frozen=True, slots=True)
class Change:
    """Parameters that changed in a recording, from a tick on.

    Attributes
    ----------
    segment, tick : int
        The first tick with them.
    number : int
        What ``internal.edition`` shows from then on.
    values : mapping of float
        Every parameter by name; NaN is null.
    packed : ndarray of float64, shape (n,)
        What the plant went on with.
    """

    segment: int
    tick: int
    number: int
    values: Mapping[str, float]
    packed: NDArray[np.float64]


@dataclass(frozen=True)
class Log:
    """A table with a time column and any subset of the signals.

    Attributes
    ----------
    t_s : ndarray of float64, shape (n,)
        Time of each row [s]; rises within a segment.
    segment : ndarray of int64, shape (n,)
        Between two segments the robot's pose starts anew.
    block : ndarray of int64, shape (n,), or None
        Unit of held-out splits.
    columns : mapping of float64 arrays, shape (n,)
        Signal name to values; NaN where there is no sample.
    status : mapping of int64 arrays, shape (n,)
        OPC UA status codes; empty where the file has none.
    run : mapping or None
        Version, configuration, kernels ... of the run; None for a log that is not ours.
    states : sequence of State
    changes : sequence of Change
    notices : sequence of str
        What a reader should know: rows dropped, frames lost.
    """

    path: Path
    t_s: NDArray[np.float64]
    segment: NDArray[np.int64]
    columns: Mapping[str, NDArray[np.float64]]
    block: NDArray[np.int64] | None = None
    status: Mapping[str, NDArray[np.int64]] = field(default_factory=dict)
    run: Mapping[str, Any] | None = None
    states: Sequence[State] = ()
    changes: Sequence[Change] = ()
    notices: Sequence[str] = ()

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def is_ours(self) -> bool:
        """Whether hilserver wrote it and says from which run."""
        return self.run is not None

    def ticks(self, base_period_ns: int, start_s: float = 0.0) -> NDArray[np.int64]:
        """Return the first tick at or after each row, shape (n,).

        Parameters
        ----------
        start_s : float
            Time of tick 0.
        """
        exact = (self.t_s - start_s) * (NS_PER_S / base_period_ns)
        return np.asarray(np.ceil(exact - 1e-3), dtype=np.int64)
