"""A server that stops: what it has accepted is not lost, whenever it comes."""

import asyncio
import contextlib
import gc
import socket

import pytest
import uvloop

from hilserver.program.event_loop import TURNS_TO_CALL_BACK, stop_listening


async def stop_after(turns: int) -> None:
    """Let a client come in so many turns of the loop before the stop."""

    def enter(_: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.transport.abort()

    server = await asyncio.start_server(enter, "127.0.0.1", 0)
    with socket.create_connection(server.sockets[0].getsockname()) as client:
        for _ in range(turns):
            await asyncio.sleep(0)
        await stop_listening(server)
        client.settimeout(5.0)
        with contextlib.suppress(ConnectionResetError):
            assert client.recv(1) == b""


@pytest.mark.parametrize("make_loop", [asyncio.new_event_loop, uvloop.new_event_loop])
@pytest.mark.parametrize("turns", range(TURNS_TO_CALL_BACK + 2))
def test_a_connection_that_comes_in_as_it_stops_is_closed(turns, make_loop) -> None:
    with asyncio.Runner(loop_factory=make_loop) as runner:
        runner.run(stop_after(turns))
    gc.collect()  # a socket that nobody has closed is a warning, and fails here
