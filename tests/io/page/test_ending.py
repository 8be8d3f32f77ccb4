"""The page's process ends with its daemon, and a clean end reports nothing."""

import asyncio
import contextlib
import signal
import socket
import sys

from structlog.testing import capture_logs

from hilserver.io.page import launch


class NoSetup:
    def to_json(self):
        return "{}"


async def test_a_page_that_is_too_busy_to_end_is_killed_without_an_error(monkeypatch):
    create, started = asyncio.create_subprocess_exec, asyncio.Queue()

    async def stubborn(*_, **options):
        program = "import time; time.sleep(600)"
        process = await create(sys.executable, "-c", program, **options)
        process.send_signal(signal.SIGSTOP)
        started.put_nowait(process)
        return process

    monkeypatch.setattr(asyncio, "create_subprocess_exec", stubborn)
    with socket.socket() as listener, capture_logs() as logs:
        task = asyncio.create_task(launch._run(NoSetup(), listener))
        process = await started.get()
        task.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await task
    assert process.returncode == -signal.SIGKILL
    assert logs == []
