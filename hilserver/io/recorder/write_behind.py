"""A writing thread behind a buffer of limited size: a slow disk never stops the reading."""

import threading
import time
from collections import deque
from collections.abc import Callable, Mapping
from typing import Any

from hilserver.logs import LogWriter, RecordedState
from hilserver.logs.writer import Segmented

FLUSH_EVERY_S = 0.2
SYNC_EVERY_S = 1.0
OPEN_WITHIN_S = 60.0
"""For the first file; a disk in the network that is gone would never answer."""


class NextFile:
    """Ends a file, whatever its size."""


Item = Segmented | RecordedState | NextFile | Mapping[str, Any]


class WriteBehind:
    """Takes frames, states and descriptions, and writes them in order.

    Frames beyond the buffer are dropped and counted; `check` raises if the recording has to end,
    and `on_new_file` is called in the writing thread. What the first `next_writer` raises, this
    does; TimeoutError if it has not returned after `OPEN_WITHIN_S`.
    """

    def __init__(
        self,
        next_writer: Callable[[], LogWriter],
        is_full: Callable[[LogWriter], bool],
        on_new_file: Callable[[], None],
        buffer_bytes: int,
        check: Callable[[LogWriter], None] = lambda _: None,
    ) -> None:
        self._next_writer = next_writer
        self._is_full = is_full
        self._on_new_file = on_new_file
        self._check = check
        self._limit_bytes = buffer_bytes
        self._items: deque[Item] = deque()
        self._held_bytes = 0
        self._news = threading.Condition()
        self._closing = False
        self.dropped = self.written = 0
        self.error: Exception | None = None
        self._writer: LogWriter
        self._is_begun = threading.Event()
        self._thread = threading.Thread(target=self._run, name="writer", daemon=True)
        self._thread.start()
        if not self._is_begun.wait(OPEN_WITHIN_S):
            self._closing = True  # should it still be opened, it is completed at once
            raise TimeoutError(f"no file has been opened for {OPEN_WITHIN_S:g} s")
        if self.error is not None:
            raise self.error

    def put(self, item: Item, *, wait: bool = False) -> bool:
        """Hand over an item; False: the buffer is full and the item was dropped.

        With `wait`, wait until there is room.
        """
        size = item.frames.n_bytes if isinstance(item, Segmented) else 0
        with self._news:
            while (
                wait
                and self._held_bytes
                and self._held_bytes + size > self._limit_bytes
            ):
                if self.error is not None:
                    return False
                self._news.wait(FLUSH_EVERY_S)
            if size and self._held_bytes + size > self._limit_bytes:
                self.dropped += len(item.frames) if isinstance(item, Segmented) else 0
                return False
            self._items.append(item)
            self._held_bytes += size
            self._news.notify()
        return True

    @property
    def n_bytes(self) -> int:
        """Size of the file that is written now."""
        return self._writer.n_bytes

    def close(self, timeout_s: float) -> bool:
        """Write what is held, complete the file; False if that takes longer than `timeout_s`."""
        with self._news:
            self._closing = True
            self._news.notify()
        self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _begin(self) -> None:
        try:
            # a database belongs to the thread that has opened it
            self._writer = self._next_writer()
        except Exception as error:  # noqa: BLE001 -- handed to the main thread, which raises it
            self.error = error
        finally:
            self._is_begun.set()

    def _run(self) -> None:
        self._begin()
        if self.error is not None:
            return
        try:
            self._write_all()
            self._writer.close()
        except Exception as error:  # noqa: BLE001 -- handed to the main thread, which ends
            self.error = error
            self._close_after_error()

    def _close_after_error(self) -> None:
        """Complete the file if there is room for its end; without it the file is still readable."""
        try:
            self._writer.close()
        except OSError:
            return

    def _write_all(self) -> None:
        flushed = synced = time.monotonic()
        while True:
            with self._news:
                if not self._items and not self._closing:
                    self._news.wait(FLUSH_EVERY_S)
                if not self._items and self._closing:
                    return
                item = self._items.popleft() if self._items else None
            if item is not None:
                if isinstance(item, RecordedState):
                    self._writer.add_state(item)
                elif isinstance(item, Segmented):
                    if self._is_full(self._writer):
                        self._begin_next()
                    self._writer.write(item)
                    with self._news:
                        self._held_bytes -= item.frames.n_bytes
                        self._news.notify_all()
                    self.written += len(item.frames)
                elif isinstance(item, NextFile):
                    self._begin_next()
                else:
                    self._writer.tell(item)
            now = time.monotonic()
            if now - flushed >= FLUSH_EVERY_S:
                self._writer.flush()
                flushed = now
            if now - synced >= SYNC_EVERY_S:
                self._writer.sync()
                self._check(self._writer)
                synced = time.monotonic()

    def _begin_next(self) -> None:
        self._writer.close()
        self._writer = self._next_writer()
        self._on_new_file()
