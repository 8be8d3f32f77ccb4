"""Binary frames: the signals that a browser has subscribed to, from the process image.

Little endian: version (1), number of the subscription (UInt8), signals n (UInt16), time stamp
[ms] (UInt32), tick (Double), age of that tick [s] (Double), n values (Double), n OPC UA status
codes (UInt32). A browser sends the time of the newest tick back with every command, so that no one
drives on a frozen picture.
"""

import struct
import time
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.image import Frame, ImageReader
from hilserver.status import BAD

MESSAGE_VERSION = 2
HEAD = struct.Struct("<BBHIdd")
_WRAP = 2**32


def stamp_ms() -> int:
    """Return the time stamp of now; it wraps after 49 days."""
    return time.monotonic_ns() // 1_000_000 % _WRAP


def age_ms(stamp: int) -> int:
    """Return the age of a time stamp."""
    return (stamp_ms() - stamp) % _WRAP


class Selection:
    """The signals that a browser has subscribed to."""

    def __init__(self, number: int, slots: Sequence[int]) -> None:
        self.key = (number & 0xFF, tuple(slots))
        self._slots: NDArray[np.intp] = np.array(slots, dtype=np.intp)

    def encode(self, frame: Frame, stamp: int) -> bytes:
        """Return the bytes for one frame."""
        age_s = max(time.monotonic_ns() - frame.planned_ns, 0) * 1e-9
        head = HEAD.pack(
            MESSAGE_VERSION, self.key[0], len(self._slots), stamp, frame.tick, age_s
        )
        values = frame.values[self._slots].astype("<f8").tobytes()
        return head + values + frame.status[self._slots].astype("<u4").tobytes()


POINTS = 600
MAX_PLOTTED = 24
_TIME = "sim.time_s"


def history(
    reader: ImageReader, slots: Mapping[str, int], names: Sequence[str]
) -> dict[str, Any]:
    """Return times [s] and values of signals, oldest first; None for a missing value.

    Only as many frames are read as a plot can show; they begin where time last went back.
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
            good = (frame.status[columns] < BAD) & np.isfinite(frame.values[columns])
            values = frame.values[columns].tolist()
            times.append(now_s)
            rows.append(
                [v if ok else None for v, ok in zip(values, good.tolist(), strict=True)]
            )
    return {
        "times": times,
        "series": {n: [row[i] for row in rows] for i, n in enumerate(names)},
    }
