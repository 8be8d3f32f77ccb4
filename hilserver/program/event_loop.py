"""Programs with an event loop: uvloop, and signals while it runs."""

import asyncio
import contextlib
import signal
import socket
from collections.abc import Coroutine, Iterator
from typing import Any, TypeVar

import uvloop

from hilserver.program.ending import ENDING, end_was_asked, hang_up_waits

MOST_HELD_BYTES = 131_072
TURNS_TO_CALL_BACK = 3

T = TypeVar("T")


def run(main: Coroutine[Any, Any, T]) -> T:
    """Run `main` in an event loop of its own; return what it returns."""
    with asyncio.Runner(loop_factory=uvloop.new_event_loop) as runner:
        return runner.run(main)


async def stop_listening(server: asyncio.Server) -> None:
    """Close a server once every connection that it has accepted has come to its callback.

    asyncio accepts in one turn of its loop, makes the transport in the next one and calls back in
    the one after. A server that closes in between drops the connection and leaves its socket open.
    """
    loop = asyncio.get_running_loop()
    for listener in server.sockets:
        loop.remove_reader(listener.fileno())  # no more from now on
    for _ in range(TURNS_TO_CALL_BACK):
        await asyncio.sleep(0)
    server.close()


def end_event() -> asyncio.Event:
    """Return an event that SIGINT and SIGTERM set from now on; it is set if one has come already.

    Call it once an orderly stop is possible; until then a signal ends the program at once.
    """
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in ENDING:
        loop.add_signal_handler(number, asked.set)
    if end_was_asked():
        asked.set()
    return asked


@contextlib.contextmanager
def hang_ups() -> Iterator[asyncio.Event]:
    """Give an event that SIGHUP sets while the context lasts."""
    asked = asyncio.Event()
    loop = asyncio.get_running_loop()
    before = signal.getsignal(signal.SIGHUP)
    loop.add_signal_handler(signal.SIGHUP, asked.set)
    if hang_up_waits():
        asked.set()
    try:
        yield asked
    finally:
        loop.remove_signal_handler(signal.SIGHUP)
        signal.signal(signal.SIGHUP, before)


def hold_little(transport: asyncio.BaseTransport | None) -> None:
    """Let the system hold some seconds of data at most for a client that does not read.

    By default it holds megabytes: such a client is noticed minutes late, and shows old data when
    it reads again.
    """
    connection = None if transport is None else transport.get_extra_info("socket")
    if connection is not None:
        connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, MOST_HELD_BYTES)
