"""What the ring still holds of some signals, thinned out for a plot that opens."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hilserver.image import ImageReader

POINTS = 600
MAX_PLOTTED = 24
_BAD = 0x80000000
_TIME = "sim.time_s"


def history(reader: ImageReader, slots: Mapping[str, int], names: Sequence[str]) -> dict[str, Any]:
    """Return times [s] and values of signals, oldest first; None where there was none.

    Only as many frames are read as a plot can show; a clock that goes back begins anew.
    """
    head, length = reader.head, reader.control.ring_length
    columns = [slots[name] for name in names]
    times: list[float] = []
    rows: list[list[float | None]] = []
    for number in range(max(0, head - length), head, max(1, length // POINTS)):
        frame = reader.frame(number)  # None: overwritten meanwhile
        if frame is None:
            continue
        now_s = float(frame.values[slots[_TIME]])
        if times and now_s < times[-1]:
            times, rows = [], []
        if not times or now_s > times[-1]:
            good = (frame.status[columns] < _BAD) & np.isfinite(frame.values[columns])
            values = frame.values[columns].tolist()
            times.append(now_s)
            rows.append([v if ok else None for v, ok in zip(values, good.tolist(), strict=True)])
    return {"times": times, "series": {n: [row[i] for row in rows] for i, n in enumerate(names)}}
