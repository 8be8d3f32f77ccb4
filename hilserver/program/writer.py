"""Lines for a terminal or a pipe, written by a thread that may block.

Ctrl-S, or a pipe that is not read, blocks its writer. The event loop hands its lines over and
continues; lines that do not fit in the buffer are lost and counted.
"""

import contextlib
import os
import shutil
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TextIO

LIMIT_BYTES = 256_000
DRAIN_WITHIN_S = 0.3
_RETRY_S = 0.05


def _plain(lost: int) -> str:
    return f"hilserver: {lost} lines were lost because nothing read them"


class Writer:
    """Stands between writers and a stream; `write` never blocks."""

    def __init__(
        self, stream: TextIO, lost_line: Callable[[int], str] = _plain
    ) -> None:
        self.lost_line = lost_line
        self.encoding = stream.encoding
        self._stream = stream
        self._is_terminal = stream.isatty()
        self._fd = -1  # a stream in memory never blocks
        with contextlib.suppress(OSError):
            self._fd = stream.fileno()
        self._texts: deque[bytes] = deque()
        self._held_bytes = self._lost = 0
        self._is_gone = False
        self._news = threading.Condition()
        threading.Thread(target=self._run, name="writer", daemon=True).start()

    def isatty(self) -> bool:
        """Whether the stream is a terminal."""
        return self._is_terminal

    @property
    def is_watched(self) -> bool:
        """Whether somebody may read along; a stream in memory is read at the end."""
        return self._fd >= 0

    def write(self, text: str) -> int:
        """Hand over whole lines."""
        if self._fd < 0:
            return self._stream.write(text)
        data = text.encode(self.encoding, "backslashreplace")
        with self._news:
            if self._is_gone:
                return len(text)
            if self._held_bytes + len(data) > LIMIT_BYTES:
                self._lost += text.count("\n")
            else:
                self._texts.append(data)
                self._held_bytes += len(data)
                self._news.notify_all()
        return len(text)

    def flush(self) -> None:
        """Nothing to do: the thread writes at once."""

    def drain(self, within_s: float = DRAIN_WITHIN_S) -> None:
        """Wait until everything is written, at most `within_s`."""
        with self._news:
            self._news.wait_for(lambda: not self._held_bytes, within_s)

    def _run(self) -> None:
        while True:
            with self._news:
                self._news.wait_for(lambda: self._texts)
                data = b"".join(self._texts)
                self._texts.clear()
                lost = self._lost
                self._lost = 0
            if lost:
                data += f"{self.lost_line(lost)}\n".encode(
                    self.encoding, "backslashreplace"
                )
            self._is_gone = not self._write(data)
            with self._news:
                if self._is_gone:
                    self._texts.clear()
                self._held_bytes = sum(map(len, self._texts))
                self._news.notify_all()

    def _write(self, data: bytes) -> bool:
        """Write all of it; False if nothing can ever be written again."""
        while data:
            try:
                data = data[os.write(self._fd, data) :]
            except BlockingIOError:
                time.sleep(_RETRY_S)
            except OSError:
                return False
        return True


_WIPE = "\r\x1b[K"


class Footer:
    """Stands between writers and a terminal, and keeps its own line below theirs."""

    def __init__(self, terminal: TextIO | Writer) -> None:
        self._terminal = terminal
        self._line = ""

    @property
    def encoding(self) -> str:
        """Encoding of the terminal."""
        return self._terminal.encoding

    def isatty(self) -> bool:
        """Whether the terminal really is one."""
        return self._terminal.isatty()

    def show(self, line: str) -> None:
        """Replace the line, by "" at the end; text wider than the terminal is cut off."""
        columns = shutil.get_terminal_size().columns
        self._line = line[: columns - 1]
        self.write("")
        self.flush()

    def write(self, text: str) -> int:
        """Write whole lines above the line."""
        # The cursor returns to the left, so that another program's output starts at its margin.
        footer = f"{self._line}\r" if self._line else ""
        self._terminal.write(f"{_WIPE}{text}{footer}")
        return len(text)

    def flush(self) -> None:
        """Flush the terminal."""
        self._terminal.flush()
