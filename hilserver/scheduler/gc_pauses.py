"""How long Python's garbage collector stops the event loop, measured through gc.callbacks."""

import gc
import time
from collections import deque

from hilserver.compiled.histogram import Histogram125

_REMEMBERED = 64


class GcPauses:
    """Measures every collection between `start` and `stop`."""

    def __init__(self) -> None:
        self.pauses = Histogram125()  # durations of all collections
        self._recent: deque[tuple[int, int]] = deque(maxlen=_REMEMBERED)
        self._began_ns = 0
        self._frozen = False

    def start(self, *, freeze: bool) -> None:
        """Start measuring; `freeze` first hides all objects from the collector until `stop`.

        Nothing is collected before: that would take a quarter of the start, and what is garbage by
        then is little and goes after `stop`.
        """
        if freeze:
            gc.freeze()
            self._frozen = True
        if self._collected not in gc.callbacks:
            gc.callbacks.append(self._collected)

    def stop(self) -> None:
        """Stop measuring; may be called twice."""
        if self._collected in gc.callbacks:
            gc.callbacks.remove(self._collected)
        if self._frozen:
            gc.unfreeze()
            self._frozen = False

    def overlap_ns(self, begin_ns: int, end_ns: int) -> int:
        """Return how much of a time span [ns, CLOCK_MONOTONIC] was spent collecting."""
        return sum(
            max(0, min(end_ns, b) - max(begin_ns, a)) for a, b in list(self._recent)
        )

    def _collected(self, phase: str, info: dict[str, int]) -> None:  # noqa: ARG002
        now_ns = time.monotonic_ns()
        if phase == "start":
            self._began_ns = now_ns
        elif self._began_ns:
            self.pauses.observe(now_ns - self._began_ns)
            self._recent.append((self._began_ns, now_ns))
            self._began_ns = 0
