"""Compares what a replay gives with what the log holds, bit by bit."""

import numpy as np

from hilserver.logs import Log
from hilserver.logs.csv_writer import BAD
from hilserver.logs.writer import Segmented
from hilserver.signals import Direction, SignalTable


class Comparison:
    """Counts equal ticks and remembers the first difference."""

    def __init__(self, log: Log, table: SignalTable, base_period_ns: int) -> None:
        outputs = [
            s for s in table.scalars if s.direction is Direction.OUT and s.name in log.columns
        ]
        self._names = [s.name for s in outputs]
        self._slots = np.array([s.slots[0] for s in outputs], dtype=np.intp)
        self._log, self._ticks = log, log.ticks(base_period_ns)
        self._starts = {int(s): int(np.argmax(log.segment == s)) for s in np.unique(log.segment)}
        self.n_signals, self.n_ticks = len(outputs), 0
        self.difference: str | None = None

    def add(self, batch: Segmented) -> None:
        """Compare frames with the rows of the same segment and tick."""
        if not self.n_signals or self.difference is not None:
            return
        segment = int(batch.segments[0])
        ticks, start = batch.frames.ticks, self._starts[segment]
        end = start + int((self._log.segment == segment).sum())
        rows = start + np.searchsorted(self._ticks[start:end], ticks)
        values = batch.frames.values[:, self._slots]
        values[(batch.frames.status[:, self._slots] & BAD) != 0] = np.nan
        for index, name in enumerate(self._names):
            recorded, ours = self._log.columns[name][rows], values[:, index].copy()
            equal = (recorded.view(np.int64) == ours.view(np.int64)) | (
                np.isnan(recorded) & np.isnan(ours)
            )
            if not equal.all():
                at = int(np.argmin(equal))
                self.difference = (
                    f"{name} in tick {ticks[at]} of segment {segment}: recorded"
                    f" {float(recorded[at])!r}, replayed {float(ours[at])!r}"
                )
                return
        self.n_ticks += len(ticks)
