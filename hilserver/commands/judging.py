"""Judges a drive that a command computes by the requirements of a file."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hilserver.daemon.assembly import Assembly
from hilserver.errors import FailedError
from hilserver.logs import Segmented
from hilserver.requirements import Drive, Judge, load_requirements


class DriveJudge:
    """Requirements of a file, and the values of the drive that they need.

    `between_s`: only this part of the simulated time is judged, and times count from its start.
    """

    def __init__(
        self,
        assembly: Assembly,
        path: Path,
        between_s: tuple[float, float] = (0.0, np.inf),
    ) -> None:
        self._judge = Judge(load_requirements(path), assembly.table, path)
        self._period_s = assembly.base_period_ns * 1e-9
        self._slots = [assembly.table.slot(name) for name in self._judge.signals]
        half_s = self._period_s / 2
        self._between_s = between_s[0] - half_s, between_s[1] + half_s
        self._values: list[NDArray[np.float64]] = []
        self._segment = 0

    def add(self, batch: Segmented) -> None:
        """Keep the values that the requirements need; a new segment is a new drive."""
        if batch.segments[0] != self._segment:
            self._segment = int(batch.segments[0])
            self._values.clear()
        time_s = batch.frames.ticks * self._period_s
        inside = (self._between_s[0] < time_s) & (time_s < self._between_s[1])
        self._values.append(batch.frames.values[inside][:, self._slots])

    def passed(self) -> bool:
        """Print every margin; return whether all requirements are met."""
        no_rows = np.empty((0, len(self._slots)))
        values = np.concatenate([*self._values, no_rows])
        if not len(values):
            raise FailedError("--between: the drive has no tick there")
        drive = Drive(
            self._period_s, dict(zip(self._judge.signals, values.T, strict=True))
        )
        margins = self._judge.margins(drive)
        for name, margin in margins.items():
            print(f"{'met' if margin >= 0.0 else 'NOT MET':8}{margin:12.6g}  {name}")
        return all(margin >= 0.0 for margin in margins.values())
