"""Child processes: started for a context, asked to end when it ends, else killed."""

import asyncio
import contextlib
import re
import signal
import socket
import subprocess
import sys
from collections.abc import AsyncIterator, Iterator, Sequence
from typing import Any

import structlog

from hilserver.time_limit import time_limit

_log = structlog.get_logger(__name__)


def free_port(host: str = "127.0.0.1") -> int:
    """Return a TCP port of `host` that is free now, for a server that we start."""
    with socket.socket() as probe:
        probe.bind((host, 0))
        return int(probe.getsockname()[1])


def python(*arguments: str) -> list[str]:
    """Return the command line of a Python process like this one."""
    return [sys.executable, *arguments]


@contextlib.asynccontextmanager
async def started(
    command: Sequence[str], *, name: str, stop_limit_s: float, **options: Any
) -> AsyncIterator[asyncio.subprocess.Process]:
    """Run a child of an event loop while the context lasts.

    Ctrl-C does not reach it: it ends us first, and we end the child.

    With `stop_limit_s` 0 the child is killed at once; else it gets SIGTERM first. Options are those
    of `asyncio.create_subprocess_exec`.
    """
    process = await asyncio.create_subprocess_exec(
        *command, stdin=asyncio.subprocess.DEVNULL, start_new_session=True, **options
    )
    try:
        yield process
    finally:
        await end(process, name, stop_limit_s)


async def end(
    process: asyncio.subprocess.Process, name: str, stop_limit_s: float
) -> None:
    """End a child, if need be by force; parameters as for `started`."""
    if process.returncode is not None:
        return
    with contextlib.suppress(ProcessLookupError):
        if stop_limit_s:
            process.terminate()
            try:
                async with time_limit(stop_limit_s):
                    await process.wait()
            except TimeoutError:
                _log.error("did not stop in time and was killed", process=name)
        process.kill()
    await process.wait()


def how_ended(code: int | None) -> str:
    """Say how a process has ended, by its return code."""
    if code is None or code >= 0:
        return f"ended with exit code {code}"
    known = -code in {*signal.Signals}
    return f"was ended by {signal.Signals(-code).name if known else f'signal {-code}'}"


async def write(process: asyncio.subprocess.Process, text: bytes) -> None:
    """Write to a child's standard input; no effect if the child has ended."""
    if process.stdin is not None:
        with contextlib.suppress(
            ConnectionError, RuntimeError
        ):  # uvloop's error for a closed pipe
            process.stdin.write(text)
            await process.stdin.drain()


async def line_of(
    process: asyncio.subprocess.Process, pattern: re.Pattern[bytes], within_s: float
) -> re.Match[bytes] | None:
    """Return the first line on standard output in which `pattern` is found.

    None if the child ends, or does not print one in time.
    """
    if process.stdout is not None:
        with contextlib.suppress(TimeoutError):
            async with time_limit(within_s):
                while line := await process.stdout.readline():
                    if match := pattern.search(line):
                        return match
    return None


@contextlib.contextmanager
def piped(
    command: Sequence[str], *, name: str, stop_limit_s: float = 20.0, **options: Any
) -> "Iterator[subprocess.Popen[str]]":
    """Run a child without an event loop, its standard input and output as text pipes by default.

    At the end its pipes are closed and it is terminated; parameters as for `started`.
    """
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    process = subprocess.Popen(command, **(pipes | options))  # noqa: S603 - our own command lines
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        try:
            process.communicate(timeout=stop_limit_s)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            print(f"hilserver: {name} did not stop and was killed", file=sys.stderr)
