"""Counts the pauses of Python's garbage collector."""

import gc
import time
from collections.abc import Callable

from hilserver.compiled.histogram import Histogram125


class GcPauses:
    """A histogram of collector pauses, filled by ``gc.callbacks`` between `start` and `stop`.

    Attributes
    ----------
    histogram : Histogram125
        All pauses since construction.
    last_end_ns : int
        CLOCK_MONOTONIC [ns] at which the newest pause ended; 0 before the first. A late wake just
        before it has a name.
    """

    def __init__(self, clock_ns: Callable[[], int] = time.monotonic_ns) -> None:
        self.histogram = Histogram125()
        self.last_end_ns = 0
        self._clock_ns = clock_ns
        self._begin_ns: int | None = None

    def start(self) -> None:
        """Begin to listen; calling it twice counts nothing twice."""
        if self._on_collection not in gc.callbacks:
            gc.callbacks.append(self._on_collection)

    def stop(self) -> None:
        """Stop listening."""
        if self._on_collection in gc.callbacks:
            gc.callbacks.remove(self._on_collection)

    def _on_collection(self, phase: str, _info: dict[str, int]) -> None:
        now_ns = self._clock_ns()
        if phase == "start":
            self._begin_ns = now_ns
        elif self._begin_ns is not None:
            self.histogram.observe(now_ns - self._begin_ns)
            self.last_end_ns = now_ns
            self._begin_ns = None
