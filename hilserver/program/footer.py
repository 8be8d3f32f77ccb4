"""A line that stays the last one on a terminal while others are written above it."""

import shutil
from typing import Self, TextIO

from hilserver.program.writer import Writer

_WIPE = "\r\x1b[K"


class Footer:
    """Stands between writers and a terminal, and keeps its own line below theirs.

    A context manager; at its end the line is gone.
    """

    def __init__(self, terminal: TextIO | Writer) -> None:
        self._terminal = terminal
        self._line = ""

    @property
    def encoding(self) -> str:
        """Encoding of the terminal."""
        return self._terminal.encoding

    def isatty(self) -> bool:
        """Whether the terminal is one."""
        return self._terminal.isatty()

    def show(self, line: str) -> None:
        """Replace the line; what does not fit the terminal's width is left out."""
        columns = shutil.get_terminal_size().columns
        self._line = line[: columns - 1]
        self.write("")
        self.flush()

    def write(self, text: str) -> int:
        """Write whole lines above the line."""
        # The cursor returns to the left: what another program writes begins a line, too.
        footer = f"{self._line}\r" if self._line else ""
        self._terminal.write(f"{_WIPE}{text}{footer}")
        return len(text)

    def flush(self) -> None:
        """Flush the terminal."""
        self._terminal.flush()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.show("")
