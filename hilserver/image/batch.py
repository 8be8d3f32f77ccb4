"""Many frames at once: what recorders and replays read from the ring."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilserver.image.reader import Frame, ImageReader


@dataclass(frozen=True, slots=True)
class FrameBatch:
    """Frames that follow each other without a gap."""

    first: int  # number of the first frame, see `Frame.number`
    # shape (n, 3 + n_slots); tick, planned start [ns], rows latched, and the OPC UA status codes
    words: NDArray[np.int64]
    values: NDArray[np.float64]  # shape (n, n_slots)

    def __len__(self) -> int:
        return len(self.values)

    @property
    def ticks(self) -> NDArray[np.int64]:
        """Ticks that made the frames, shape (n,)."""
        return self.words[:, 0]

    @property
    def planned_ns(self) -> NDArray[np.int64]:
        """Planned starts of the ticks [ns], CLOCK_MONOTONIC, shape (n,)."""
        return self.words[:, 1]

    @property
    def status(self) -> NDArray[np.int64]:
        """OPC UA status codes, shape (n, n_slots)."""
        return self.words[:, 3:]

    @property
    def numbers(self) -> NDArray[np.int64]:
        """Numbers of the frames, shape (n,)."""
        return np.arange(self.first, self.first + len(self), dtype=np.int64)

    def kept(self, rows: NDArray[np.bool_]) -> "FrameBatch":
        """Return some of the frames; they are numbered anew from the first on."""
        return FrameBatch(self.first, self.words[rows], self.values[rows])

    @property
    def n_bytes(self) -> int:
        """Memory that the frames take."""
        return self.words.nbytes + self.values.nbytes


def to_batch(frames: Sequence[Frame]) -> FrameBatch:
    """Put frames together that follow each other, one at least."""
    heads = [(frame.tick, frame.planned_ns, frame.latched_rows) for frame in frames]
    status = np.stack([frame.status for frame in frames])
    words = np.concatenate([np.array(heads, dtype=np.int64), status], axis=1)
    return FrameBatch(frames[0].number, words, np.stack([frame.values for frame in frames]))


def read_frames(reader: ImageReader, first: int, limit: int) -> FrameBatch:
    """Copy up to `limit` frames from `first` on; fewer when the ring has no more, maybe none."""
    rows, n_slots = reader.rows(first, limit), reader.n_slots
    values = rows[:, 4 : 4 + n_slots].copy().view(np.float64)
    return FrameBatch(first, np.delete(rows[:, 1:], np.s_[3 : 3 + n_slots], axis=1), values)
