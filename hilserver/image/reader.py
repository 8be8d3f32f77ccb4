"""Reads frames of the process image without compiled code, for all other processes.

A process that only watches (page, recorder, teleop) should not load numba, which takes 70 MB and
most of a second. Here `fence` replaces the atomic instructions of `ring`.
"""

import json
from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import FailedError
from hilserver.image import layout as lay
from hilserver.image import word
from hilserver.image.shared_file import map_read_only


def fence() -> None:
    """Order all loads before it before all loads after it, on ARM, too.

    Nothing before a release moves after it, nothing after an acquisition moves before it, and an
    acquisition never moves before the release of the same lock. The compiler cannot see into the
    interpreter's own code.
    """
    lock = Lock()
    lock.acquire()
    lock.release()
    lock.acquire()


@dataclass(frozen=True, slots=True)
class Frame:
    """All signals of one tick."""

    number: int  # how many frames were published before this one
    tick: int  # the tick that computed the values
    planned_ns: int  # planned start of that tick, CLOCK_MONOTONIC
    # input rows latched up to this frame, see `ProcessImage.pushed_rows`
    latched_rows: int
    values: NDArray[np.float64]  # shape (n_slots,)
    status: NDArray[np.int64]  # shape (n_slots,); OPC UA status codes


class ControlWords:
    """What daemon and plant exchange besides signals; ``STATE`` in `word` is the attribute `state`.

    Setting a word of a read-only arena raises a ValueError.
    """

    words: NDArray[np.int64]

    def __init__(self, words: NDArray[np.int64]) -> None:
        object.__setattr__(self, "words", words)

    def __getattr__(self, name: str) -> int:
        return int(self.words[getattr(word, name.upper())])

    def __setattr__(self, name: str, value: int) -> None:
        self.words[getattr(word, name.upper())] = value


class ImageReader:
    """Reads frames of an arena, in the daemon or, through `attach`, in any other process."""

    def __init__(self, buffer: Any) -> None:
        # the whole arena, viewed as either type
        self.values: NDArray[np.float64] = np.frombuffer(buffer, dtype=np.float64)
        self.words: NDArray[np.int64] = np.frombuffer(buffer, dtype=np.int64)
        self.control = ControlWords(self.words)  # its first words, by name
        self.n_slots = self.control.n_slots
        base, length = self.words[[word.RING_BASE, word.RING_LENGTH]].tolist()
        ring = self.words[
            base : base + length * (lay.FRAME_HEADER_WORDS + 2 * self.n_slots)
        ]
        self._ring = ring.reshape(length, -1)

    @classmethod
    def attach(cls, name: str) -> "ImageReader":
        """Open the image of a running daemon for reading.

        FailedError if there is none, or it has another version.
        """
        buffer = map_read_only(name)
        words = np.frombuffer(buffer, dtype=np.int64, count=2)
        if words[word.MAGIC_WORD] != lay.MAGIC or words[word.VERSION] != lay.VERSION:
            raise FailedError(
                f"the process image '{name}' was made by another hilserver version"
            )
        return cls(buffer)

    @property
    def description(self) -> dict[str, Any]:
        """Signals and regions as named in the header."""
        start, n_bytes = lay.N_CONTROL_WORDS * 8, self.control.json_bytes
        text = self.words.view(np.uint8)[start : start + n_bytes].tobytes()
        description: dict[str, Any] = json.loads(text)
        return description

    @property
    def head(self) -> int:
        """Number of frames published so far."""
        return self.control.ring_head

    @property
    def live(self) -> NDArray[np.int64]:
        """The content of a snapshot, in one piece; only the plant may write it while it runs."""
        return self._state_at(self.control.live_base)

    @property
    def shadow(self) -> NDArray[np.int64]:
        """The copy of `live` that the plant saves to, or loads from, between two ticks."""
        return self._state_at(self.control.shadow_base)

    def _state_at(self, base: int) -> NDArray[np.int64]:
        return self.words[base : base + self.control.live_length]

    def latest(self) -> Frame | None:
        """Return a copy of the newest frame, None before the first."""
        for _ in range(lay.READ_TRIES):
            number = self.head - 1
            frame = self.frame(number)
            if frame is not None or number < 0:
                return frame
        return None  # in each try the writer overwrote the frame

    def frame(self, number: int) -> Frame | None:
        """Return frame `number` while it is in the ring, else None."""
        if not 0 <= number < self.head:
            return None
        row, n, complete = (
            self._ring[number & (len(self._ring) - 1)],
            self.n_slots,
            2 * number + 2,
        )
        if row[0] != complete:
            return None
        fence()
        words = row.copy()
        fence()
        if row[0] != complete:
            return None
        tick, planned_ns, latched = words[1:4].tolist()
        values, status = words[4 : 4 + n].view(np.float64), words[4 + n :]
        return Frame(number, tick, planned_ns, latched, values, status)

    def rows(self, first: int, most: int) -> NDArray[np.int64]:
        """Copy frames from `first` on, up to one that is not there yet or no longer there.

        Returns
        -------
        ndarray of int64, shape (n, 4 + 2 * n_slots)
            Sequence, tick, planned start [ns], rows latched so far, values, and status codes.
        """
        numbers = (
            np.arange(first, min(first + most, self.head))
            if first >= 0
            else np.arange(0)
        )
        places, complete = numbers & (len(self._ring) - 1), 2 * numbers + 2
        begun = self._ring[places, 0]
        fence()
        rows: NDArray[np.int64] = self._ring[places]
        fence()
        whole = (begun == complete) & (self._ring[places, 0] == complete)
        return rows if whole.all() else rows[: np.argmin(whole)]

    def region(self, name: str) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
        """Return a region of the arena as float64 and as int64."""
        base, length = self.description["regions"][name]
        return self.values[base : base + length], self.words[base : base + length]


@dataclass(frozen=True, slots=True)
class FrameBatch:
    """Successive frames without a gap."""

    first: int  # number of the first frame, see `Frame.number`
    # shape (n, 3 + n_slots); tick, planned start [ns], rows latched, and the OPC UA status codes
    words: NDArray[np.int64]
    values: NDArray[np.float64]  # shape (n, n_slots)

    def __len__(self) -> int:
        return len(self.values)

    @property
    def ticks(self) -> NDArray[np.int64]:
        """Ticks of the frames, shape (n,)."""
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
        """Return some of the frames, renumbered from the first."""
        return FrameBatch(self.first, self.words[rows], self.values[rows])

    @property
    def n_bytes(self) -> int:
        """Memory used by the frames."""
        return self.words.nbytes + self.values.nbytes


def to_batch(frames: Sequence[Frame]) -> FrameBatch:
    """Join successive frames, at least one."""
    heads = [(frame.tick, frame.planned_ns, frame.latched_rows) for frame in frames]
    status = np.stack([frame.status for frame in frames])
    words = np.concatenate([np.array(heads, dtype=np.int64), status], axis=1)
    return FrameBatch(
        frames[0].number, words, np.stack([frame.values for frame in frames])
    )


def read_frames(reader: ImageReader, first: int, limit: int) -> FrameBatch:
    """Copy up to `limit` frames from `first` on; fewer, or none, if the ring has no more."""
    rows, n_slots = reader.rows(first, limit), reader.n_slots
    values = rows[:, 4 : 4 + n_slots].copy().view(np.float64)
    return FrameBatch(
        first, np.delete(rows[:, 1:], np.s_[3 : 3 + n_slots], axis=1), values
    )
