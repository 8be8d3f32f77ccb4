"""Starts the page beside a daemon, starts it again when it fails, and ends it with the daemon."""

import asyncio
import contextlib
import socket
import sys
from collections.abc import AsyncIterator

import structlog

from hilserver.io.page.setup import Setup

STOP_LIMIT_S = 5.0
RESTART_S = 1.0
LONGEST_RESTART_S = 60.0
STEADY_S = 60.0

_log = structlog.get_logger(__name__)


@contextlib.asynccontextmanager
async def running_page(setup: Setup, listener: socket.socket) -> AsyncIterator[None]:
    """Run the page while the context lasts; the daemon never waits for it.

    Parameters
    ----------
    listener : socket
        Stays ours, so that a page that is started again has the same address.
    """
    task = asyncio.create_task(_keep_running(setup, listener), name="page")
    try:
        yield
    finally:
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task


async def _keep_running(setup: Setup, listener: socket.socket) -> None:
    loop, wait_s = asyncio.get_running_loop(), RESTART_S
    while True:
        started_s = loop.time()
        try:
            code: int | str = await _run(setup, listener)
        except OSError as error:
            code = error.strerror or str(error)
        if loop.time() - started_s > STEADY_S:
            wait_s = RESTART_S
        _log.error("the page has ended, the daemon runs on", exit=code, again_in_s=wait_s)
        await asyncio.sleep(wait_s)
        wait_s = min(2 * wait_s, LONGEST_RESTART_S)


async def _run(setup: Setup, listener: socket.socket) -> int:
    fd = listener.fileno()
    process = await asyncio.create_subprocess_exec(
        *(sys.executable, "-m", "hilserver", "page", "--beside", str(fd)),
        stdin=asyncio.subprocess.PIPE,
        stdout=asyncio.subprocess.DEVNULL,
        pass_fds=(fd,),
        start_new_session=True,  # Ctrl-C ends the daemon first, and the daemon ends the page
    )
    try:
        if process.stdin is not None:  # stays open: its end tells the page that we are gone
            process.stdin.write(setup.to_json().encode() + b"\n")
            with contextlib.suppress(ConnectionError):
                await process.stdin.drain()
        return await process.wait()
    finally:
        await _stop(process)


async def _stop(process: asyncio.subprocess.Process) -> None:
    if process.returncode is not None:
        return
    with contextlib.suppress(ProcessLookupError):
        process.terminate()
        try:
            async with asyncio.timeout(STOP_LIMIT_S):
                await process.wait()
        except TimeoutError:
            process.kill()
            await process.wait()
