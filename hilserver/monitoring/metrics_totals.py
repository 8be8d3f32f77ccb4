"""Totals over the life of the process, made from figures that may be reset.

A Prometheus counter that goes back looks like a restart of the program. ``ResetStatistics`` clears
the figures a person looks at; what is exported keeps counting::

    figure   3  5  5 |reset| 0  2  4
    total    3  5  5         5  7  9
"""

from collections.abc import Hashable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hilserver.metrics import Reading

Counts = NDArray[np.int64]


@dataclass(slots=True)
class _Entry:
    last: Reading
    total: Counts
    total_sum_ns: int = 0


@dataclass(slots=True)
class LifetimeTotals:
    """Adds up what every source counted between two readings; a fallen count is a reset."""

    _entries: dict[Hashable, _Entry] = field(default_factory=dict)

    def advance(self, key: Hashable, reading: Reading) -> Reading:
        """Take in the newest `reading` of `key`; return its total since the process began."""
        entry = self._entry(key, reading)
        was_reset = bool((reading.counts < entry.last.counts).any())
        entry.total += reading.counts if was_reset else reading.counts - entry.last.counts
        entry.total_sum_ns += reading.sum_ns - (0 if was_reset else entry.last.sum_ns)
        entry.last = reading
        return Reading(entry.total.copy(), entry.total_sum_ns)

    def rebase(self, key: Hashable, reading: Reading) -> None:
        """Count on from `reading` without adding it: the source has just been reset."""
        self._entry(key, reading).last = reading

    def _entry(self, key: Hashable, reading: Reading) -> _Entry:
        if key not in self._entries:
            zeros = np.zeros_like(reading.counts)
            self._entries[key] = _Entry(last=Reading(zeros), total=zeros.copy())
        return self._entries[key]
