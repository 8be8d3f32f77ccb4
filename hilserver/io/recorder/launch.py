"""Starts a recorder beside a daemon, before the first tick, and ends it after the last."""

import asyncio
import contextlib
import signal
import sys
from collections.abc import AsyncIterator
from pathlib import Path

import structlog

from hilserver.config.recording import RecordingConfig
from hilserver.errors import FailedError

READY = b"recording "
START_LIMIT_S = 30.0
STOP_LIMIT_S = 30.0

_log = structlog.get_logger(__name__)


@contextlib.asynccontextmanager
async def running_recorder(
    config: RecordingConfig, image: str, folder: Path
) -> AsyncIterator[None]:
    """Record the image `image` while the context lasts; entered once the recorder is attached.

    Raises
    ------
    FailedError
        If it does not come up.
    """
    process = await asyncio.create_subprocess_exec(
        *_command(config, image, folder),
        stdin=asyncio.subprocess.DEVNULL,
        stdout=asyncio.subprocess.PIPE,
        start_new_session=True,  # Ctrl-C ends the daemon first, and the daemon ends the recorder
    )
    watch: asyncio.Task[None] | None = None
    try:
        await _attached(process)
        watch = asyncio.create_task(_watch(process), name="watch recorder")
        yield
    finally:
        if watch is not None:
            watch.cancel()
        await _stop(process)


def _command(config: RecordingConfig, image: str, folder: Path) -> list[str]:
    words = [sys.executable, "-m", "hilserver", "record", "--image", image]
    words += ["--out", str(folder / str(config.file)), "--buffer-mb", str(config.buffer_mb)]
    for pattern in config.signals:
        words += ["--signals", pattern]
    if config.rotate_mb is not None:
        words += ["--rotate-mb", str(config.rotate_mb)]
    if config.keep is not None:
        words += ["--keep", str(config.keep)]
    return words


async def _attached(process: asyncio.subprocess.Process) -> None:
    if process.stdout is not None:
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(START_LIMIT_S):
                while line := await process.stdout.readline():
                    if line.startswith(READY):
                        return
    raise FailedError("the recorder did not start; see its message above")


async def _watch(process: asyncio.subprocess.Process) -> None:
    code = await process.wait()
    _log.error("the recording has ended, the daemon runs on", exit_code=code)


async def _stop(process: asyncio.subprocess.Process) -> None:
    if process.returncode is not None:
        return
    with contextlib.suppress(ProcessLookupError):
        process.send_signal(signal.SIGTERM)
    try:
        async with asyncio.timeout(STOP_LIMIT_S):
            await process.wait()
    except TimeoutError:
        _log.error("the recorder did not end in time")
        process.kill()
        await process.wait()
