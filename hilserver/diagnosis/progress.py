"""What is being done, for the waiting user, and how long each part took."""

import time
from collections.abc import Callable
from copy import copy

Report = Callable[[str, float], None]
"""Called with the current activity and the share of it that is done."""


class Tracker:
    """Reports what a diagnosis does and measures its parts.

    Attributes
    ----------
    timings_s : dict of str to float
        By part, of all groups together.
    """

    def __init__(self, report: Report | None = None) -> None:
        self.timings_s: dict[str, float] = {}
        self._report, self._start_s, self._group = report, time.perf_counter(), ""

    def __call__(self, text: str, share: float) -> None:
        """Report the current activity and its share."""
        if self._report is not None:
            self._report(f"{self._group}{text}", share)

    def timed(self, part: str) -> None:
        """Add the time since the previous part to a part."""
        spent_s = time.perf_counter() - self._start_s - sum(self.timings_s.values())
        self.timings_s[part] = self.timings_s.get(part, 0.0) + spent_s

    def of_group(self, name: str) -> "Tracker":
        """Return a tracker for one group, whose times count with those of the others."""
        other = copy(self)
        other._group = f"{name}: "
        return other
