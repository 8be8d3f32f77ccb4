"""Starts a recorder beside a daemon, before the first tick, and ends it after the last."""

import asyncio
import contextlib
import re
from collections import deque
from collections.abc import AsyncIterator, Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import structlog

from hilserver.config.recording import RecordingConfig
from hilserver.errors import FailedError
from hilserver.program import children
from hilserver.program.guard import allow
from hilserver.tasks import SupervisedTask, Supervisor

PREFIX = "hilserver: "  # of error messages
READY = re.compile(rb"^recording ")
START_LIMIT_S = 600.0
STOP_LIMIT_S = 30.0

_log = structlog.get_logger(__name__)


@dataclass
class RecorderEnd:
    """How a recorder has ended."""

    by_itself: asyncio.Event = field(default_factory=asyncio.Event)
    why: str = ""  # once it has ended, why the recording is not whole; empty: it is


@contextlib.asynccontextmanager
async def running_recorder(
    config: RecordingConfig, image: str, folder: Path, tasks: Supervisor
) -> AsyncIterator[RecorderEnd]:
    """Record the image `image` while the context lasts; entered once the recorder is attached.

    Gives how it ends, complete when the context has ended. FailedError if the recorder does not
    start.
    """
    messages: SupervisedTask | None = None
    end, said = RecorderEnd(), deque[str](maxlen=1)

    async def look(process: asyncio.subprocess.Process) -> None:
        await process.wait()
        if messages is not None:
            await asyncio.wait({messages.task})  # ends with the process
        if process.returncode:
            how = f"the recorder {children.how_ended(process.returncode)}"
            end.why = said[-1] if process.returncode > 0 and said else how
        end.by_itself.set()

    try:
        async with children.started(
            _command(config, image, folder),
            name="recorder",
            stop_limit_s=STOP_LIMIT_S,
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.PIPE,
        ) as process:
            messages = tasks.spawn(
                partial(_log_messages, process, said), "recorder's messages"
            )
            looking = tasks.spawn(partial(look, process), "recorder")
            if await children.line_of(process, READY, START_LIMIT_S) is None:
                await asyncio.wait({looking.task}, timeout=STOP_LIMIT_S)
                raise FailedError(end.why or "the recorder did not start in time")
            try:
                yield end
            finally:
                allow(STOP_LIMIT_S)
        await asyncio.wait({looking.task})
    finally:
        if messages is not None:
            await asyncio.wait({messages.task})


@contextlib.contextmanager
def recorder_inside(
    config: RecordingConfig, image: str, folder: Path, tell: Callable[[str], object]
) -> Iterator[Callable[[], None]]:
    """Record the image `image` from inside its daemon; give a function to call after every batch.

    In virtual time no other process could keep up. Here time waits: no frame is lost. `tell` is
    called with the reason once nothing more can be written. FailedError if the file cannot be made.
    """
    from hilserver.io.recorder.recorder import Recorder  # noqa: PLC0415 -- what else runs beside it
    from hilserver.io.recorder.series import Settings  # noqa: PLC0415 -- likewise

    is_reported = False
    settings = Settings(
        path=folder / str(config.file),
        signals=config.signals,
        rotate_bytes=None
        if config.rotate_mb is None
        else round(config.rotate_mb * 1e6),
        keep=config.keep,
        max_bytes=config.max_mb * 1e6,
        keep_free_bytes=config.keep_free_mb * 1e6,
        buffer_bytes=round(config.buffer_mb * 1e6),
        waits=True,
    )
    recorder = Recorder(image, settings)

    def look() -> None:
        nonlocal is_reported
        recorder.look()
        if not is_reported and (why := recorder.why_ended):
            is_reported = True
            tell(why)

    try:
        yield look
    finally:
        allow(STOP_LIMIT_S)
        try:
            _log.info(recorder.close())
        except FailedError as error:
            _log.error("the recording failed", reason=str(error))


def _command(config: RecordingConfig, image: str, folder: Path) -> list[str]:
    words = children.python("-m", "hilserver", "record", "--image", image)
    words += [
        "--out",
        str(folder / str(config.file)),
        "--buffer-mb",
        str(config.buffer_mb),
    ]
    words += [
        "--max-mb",
        str(config.max_mb),
        "--keep-free-mb",
        str(config.keep_free_mb),
    ]
    for pattern in config.signals:
        words += ["--signals", pattern]
    if config.rotate_mb is not None:
        words += ["--rotate-mb", str(config.rotate_mb)]
    if config.keep is not None:
        words += ["--keep", str(config.keep)]
    return words


async def _log_messages(process: asyncio.subprocess.Process, said: deque[str]) -> None:
    """Log the recorder's messages, whose lines must not be mixed with ours; keep its complaints."""
    assert process.stderr is not None
    while line := await process.stderr.readline():
        text = line.decode(errors="replace").rstrip()
        if text.startswith(PREFIX):
            text = text.removeprefix(PREFIX)
            said.append(text)
            _log.warning(text)
        else:
            _log.info(text)
