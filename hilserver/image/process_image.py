"""The daemon's side of the process image: creates it and pushes rows."""

import os
from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilserver.image import layout as lay
from hilserver.image import word
from hilserver.image.queues import push_rows
from hilserver.image.reader import ImageReader
from hilserver.image.shared_file import OwnMemory, SharedFile
from hilserver.signals import SignalTable
from hilserver.status import GOOD


class Row(NamedTuple):
    """One write for the plant; a value of NaN leaves the value and sets only the status."""

    slot: int
    value: float
    status: int = GOOD
    tick: int = 0


class ProcessImage(ImageReader):
    """The daemon's own image, which owns the memory and produces the input rows.

    Parameters
    ----------
    name : str
        Name in shared memory, for one daemon only. Empty: private to this process.
    live, fixed : mapping of int
        Words of the plant's regions; those in `live` are part of a snapshot.
    base_period_ns : int
        Base period of the scheduler.
    ring_length, queue_rows : int
        Number of frames kept, and rows per input queue; powers of two.
    run : mapping, optional
        Origin of the values (version, configuration, ...), for recorders.
    """

    def __init__(
        self,
        name: str,
        table: SignalTable,
        *,
        live: Mapping[str, int],
        fixed: Mapping[str, int],
        base_period_ns: int,
        ring_length: int = 2048,
        queue_rows: int = 8192,
        run: Mapping[str, Any] | None = None,
    ) -> None:
        self.name = name
        self._table, self._run = table, dict(run or {})
        self.layout = lay.make_layout(
            table.n_slots,
            ring_length=ring_length,
            queue_rows=queue_rows,
            live=dict(live),
            fixed=dict(fixed),
        )
        n_bytes = self.layout.total_words * 8
        self._file = SharedFile(name, n_bytes) if name else OwnMemory(n_bytes)
        words = np.frombuffer(self._file.map, dtype=np.int64)
        self._fill_header(words, base_period_ns)
        super().__init__(self._file.map)
        for signal in table.scalars:
            self.frame_values[signal.slots[0]] = signal.initial

    def _fill_header(self, words: NDArray[np.int64], period_ns: int) -> None:
        layout, region = self.layout, self.layout.regions
        self._describe(words)
        header = {
            word.VERSION: lay.VERSION,
            word.PID: os.getpid(),
            word.N_SLOTS: layout.n_slots,
            word.RING_LENGTH: layout.ring_length,
            word.RING_STRIDE: layout.stride,
            word.RING_BASE: region["ring"].base,
            word.FRAME_BASE: region["frame"].base,
            word.STATUS_BASE: region["status"].base,
            word.NOW_BASE: region["now"].base,
            word.NOW_CAPACITY: layout.queue_rows,
            word.TIMED_BASE: region["timed"].base,
            word.TIMED_CAPACITY: layout.queue_rows,
            word.LIVE_BASE: region["live"].base,
            word.LIVE_LENGTH: region["live"].length,
            word.SHADOW_BASE: region["shadow"].base,
            word.BASE_PERIOD_NS: period_ns,
            word.MAGIC_WORD: lay.MAGIC,  # last: until then nobody attaches
        }
        for index, value in header.items():
            words[index] = value

    def _describe(self, words: NDArray[np.int64]) -> None:
        text = lay.describe(self._table, self.layout, self._run)
        start = lay.N_CONTROL_WORDS * 8
        # to readers an empty description is not complete yet
        words[word.JSON_BYTES] = 0
        words.view(np.uint8)[start : start + len(text)] = np.frombuffer(
            text, dtype=np.uint8
        )
        words[word.JSON_BYTES] = len(text)

    def tell(self, **run: Any) -> None:
        """Add to the description of the run, for recorders."""
        self._run |= run
        self._describe(self.words)

    @property
    def frame_values(self) -> NDArray[np.float64]:
        """The working frame; only the plant may write it while it runs."""
        region = self.layout.regions["frame"]
        return self.values[region.base : region.base + region.length]

    @property
    def frame_status(self) -> NDArray[np.int64]:
        """Status codes of the working frame; only the plant may write them while it runs."""
        region = self.layout.regions["status"]
        return self.words[region.base : region.base + region.length]

    @property
    def pushed_rows(self) -> int:
        """Rows pushed so far; a frame with as many `latched_rows` contains them."""
        return self.control.now_head

    def push(self, rows: Iterable[Row]) -> bool:
        """Push rows for the next tick, all together; False if the queue has no room."""
        return self._push(rows, word.NOW_BASE)

    @property
    def timed_room(self) -> int:
        """Rows for which the timed queue has room."""
        waiting = self.words[word.TIMED_HEAD] - self.words[word.TIMED_TAIL]
        return int(self.words[word.TIMED_CAPACITY] - waiting)

    def push_timed(self, rows: Iterable[Row]) -> bool:
        """Push rows for the ticks they name (rising); False if the queue has no room."""
        return self._push(rows, word.TIMED_BASE)

    def push_timed_table(self, table: NDArray[np.float64]) -> bool:
        """Like `push_timed`; columns are tick, slot, value and status, shape (n, 4)."""
        return self._push_table(table, word.TIMED_BASE)

    def _push(self, rows: Iterable[Row], queue: int) -> bool:
        table = np.array(
            [(r.tick, r.slot, r.value, r.status) for r in rows], dtype=np.float64
        )
        return self._push_table(table, queue)

    def _push_table(self, table: NDArray[np.float64], queue: int) -> bool:
        if table.size == 0:
            return True
        base, capacity = int(self.words[queue]), int(self.words[queue + 1])
        pushed = push_rows(
            table, base, capacity, queue + 2, queue + 3, self.values, self.words
        )
        return bool(pushed == len(table))

    def close(self) -> None:
        """Remove the image from shared memory."""
        self._file.close()
