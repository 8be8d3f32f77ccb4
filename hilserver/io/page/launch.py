"""Starts the page beside a daemon, restarts it when it fails, and ends it with the daemon."""

import asyncio
import contextlib
import socket
import sys
from collections.abc import Callable
from functools import partial

import structlog

from hilserver.io.page.setup import Setup
from hilserver.io.world import Part
from hilserver.program import children
from hilserver.tasks import SupervisedTask, Supervisor
from hilserver.time_limit import time_limit

PAGE_STOP_S = 0.7
RESTART_S = 1.0
LONGEST_RESTART_S = 60.0
STEADY_S = 60.0

_log = structlog.get_logger(__name__)


class PageBeside(Part):
    """A page that runs beside a daemon, which never waits for it.

    The daemon keeps the listener, so that a restarted page has the same address.
    """

    section = label = "page"

    def __init__(
        self,
        setup: Callable[[], Setup],
        listener: socket.socket,
        address: str,
        tasks: Supervisor,
    ) -> None:
        self._setup, self._listener, self._address = setup, listener, address
        self._tasks = tasks
        self._job: SupervisedTask | None = None

    @property
    def address(self) -> str:
        """The address of the page."""
        return self._address

    async def start(self) -> None:
        """Start it, without waiting for it."""
        self._job = self._tasks.keep(
            "page", partial(_keep_running, self._setup(), self._listener)
        )

    async def stop(self) -> None:
        """End it."""
        if self._job is not None:
            await self._job.end()


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
        _log.error(
            "the page has stopped; the daemon keeps running",
            exit=code,
            again_in_s=wait_s,
        )
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
        # its standard input stays open until we end, which ends the page
        await children.write(process, setup.to_json().encode() + b"\n")
        return await process.wait()
    finally:
        # A clean end: it keeps nothing that could be lost, so a busy one is killed without a word.
        with contextlib.suppress(ProcessLookupError):
            process.terminate()
        with contextlib.suppress(TimeoutError):
            async with time_limit(PAGE_STOP_S):
                await process.wait()
        await children.end(process, "page", 0.0)
