"""A program of the user's own that runs beside us for a while.

Its last words are kept, and it ends with our context, together with all that it has started.
"""

import asyncio
import contextlib
import os
import signal
from collections import deque
from collections.abc import AsyncIterator, Mapping, Sequence
from functools import partial
from resource import RLIMIT_DATA, prlimit
from typing import Any, Final

from hilserver.errors import FailedError
from hilserver.program.children import how_ended
from hilserver.program.workers import end_with_parent

_LAST_LINES: Final = 20


class NotStarted(FailedError):
    """There is no such program, or it cannot be run."""


class Guest:
    """The program, and the end of its error output."""

    def __init__(self, name: str, process: asyncio.subprocess.Process) -> None:
        self.name = name
        self._process = process
        self._lines: deque[str] = deque(maxlen=_LAST_LINES)

    @property
    def has_ended(self) -> bool:
        """Whether it runs no longer."""
        return self._process.returncode is not None

    @property
    def has_failed(self) -> bool:
        """Whether it has ended, and not with exit code 0."""
        return self.has_ended and self._process.returncode != 0

    @property
    def ending(self) -> str:
        """How it has ended, with its error message."""
        code = self._process.returncode
        how = how_ended(code)
        if code == 0 or not self._lines:
            return how
        lines = list(self._lines)
        said = [line for line in lines if "rror" in line] or lines
        return f"{how}: {said[-1]:.200}"

    async def wait(self) -> None:
        """Read its error output until it has ended."""
        assert self._process.stderr is not None
        rest = b""
        while piece := await self._process.stderr.read(4096):
            *whole, rest = (rest + piece).split(b"\n")
            rest = rest[-4096:]
            self._keep(whole)
        self._keep([rest])
        await self._process.wait()

    def _keep(self, lines: Sequence[bytes]) -> None:
        texts = (line.decode("utf-8", "replace").strip() for line in lines)
        self._lines.extend(text for text in texts if text)


@contextlib.asynccontextmanager
async def guest(
    command: Sequence[str], *, memory_mb: float | None = None, **options: Any
) -> AsyncIterator[Guest]:
    """Run a program while the context lasts; NotStarted if it cannot be started.

    Somebody has to `wait` for it: a program whose error output nobody reads stands still. Options
    are those of `asyncio.create_subprocess_exec`.
    """
    try:
        process = await asyncio.create_subprocess_exec(
            *command,
            stdin=asyncio.subprocess.DEVNULL,
            stderr=asyncio.subprocess.PIPE,
            start_new_session=True,
            preexec_fn=partial(end_with_parent, os.getpid()),
            **options,
        )
    except (OSError, ValueError, TypeError) as error:
        why = (getattr(error, "strerror", None) or str(error)).lower()
        raise NotStarted(
            f"the controller '{command[0]}' cannot be started: {why}"
        ) from None
    try:
        if memory_mb is not None:
            most = int(memory_mb * 1e6)
            with contextlib.suppress(OSError):  # it has ended already
                prlimit(process.pid, RLIMIT_DATA, (most, most))
        yield Guest(command[0], process)
    finally:
        with contextlib.suppress(OSError):
            os.killpg(process.pid, signal.SIGKILL)
        # Not `kill`: it would look for the end first, which asyncio's watcher then misses.
        await process.wait()


def filled(word: str, values: Mapping[str, str]) -> str:
    """Return a word of a command with its placeholders replaced."""
    for placeholder, value in values.items():
        word = word.replace(placeholder, value)
    return word
