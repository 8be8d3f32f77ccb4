"""Progress of what has stages and shares: a bar on a terminal, plain lines elsewhere."""

import sys
import time
from collections.abc import Callable
from typing import Self, TextIO

from hilserver.program.ending import say_stopped
from hilserver.program.writer import Footer

PROGRESS_AFTER_S = 2.0
LINE_EVERY_S = 5.0


class Progress:
    """Shows the current stage and its progress, once it takes longer than two seconds.

    A context manager that removes the bar at its end. If a signal ends it, `stopped` says what is
    left, since the exit code is then that of success.
    """

    def __init__(self, stopped: Callable[[], str]) -> None:
        self._stopped = stopped
        self._start_s = time.monotonic()
        self._footer = Footer(sys.stderr)
        self._line = ""
        self._next_line_s = self._start_s + PROGRESS_AFTER_S

    def __call__(self, stage: str, share: float) -> None:
        """Show a stage and its share."""
        now_s = time.monotonic()
        if now_s - self._start_s < PROGRESS_AFTER_S:
            return
        if not sys.stderr.isatty():
            if now_s >= self._next_line_s:
                print(f"{share:4.0%} {stage}", file=sys.stderr, flush=True)
                self._next_line_s = now_s + LINE_EVERY_S
            return
        bar = "#" * round(30 * share)
        self._show(f"[{bar:<30}] {share:4.0%} {stage}")

    def _show(self, line: str) -> None:
        if line != self._line:
            self._line = line
            self._footer.show(line)

    def say(self, line: str, file: TextIO) -> None:
        """Print a line in place of the bar."""
        self.end()
        print(line, file=file, flush=True)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, error: object, *_: object) -> None:
        self.end()
        if (
            error is not None
        ):  # not SystemExit alone: a compiler may raise something else
            say_stopped(self._stopped())

    def end(self) -> None:
        """Wipe the bar."""
        self._show("")
