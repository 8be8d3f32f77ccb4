"""How tasks end."""

import asyncio
import socket

from hilserver.program import event_loop
from hilserver.tasks import end


def test_tasks_have_ended_whatever_they_do_when_they_are_cancelled() -> None:
    seen: list[str] = []

    async def tidies_up() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            await asyncio.sleep(0)
            seen.append("tidy")

    async def breaks() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            seen.append("broken")
            raise ValueError

    async def main() -> None:
        tasks = [asyncio.create_task(tidies_up()), asyncio.create_task(breaks())]
        await asyncio.sleep(0)
        await end(*tasks, None)
        assert all(task.done() for task in tasks)

    event_loop.run(main())
    assert sorted(seen) == ["broken", "tidy"]


async def test_for_who_does_not_read_the_system_holds_little():
    """Otherwise megabytes go out before anybody notices."""
    connected = asyncio.get_running_loop().create_future()
    server = await asyncio.start_server(
        lambda *both: connected.set_result(both), "127.0.0.1", 0
    )
    with socket.create_connection(server.sockets[0].getsockname()):
        _, writer = await connected
        event_loop.hold_little(writer.transport)
        for _ in range(64):
            writer.write(bytes(16_384))
            await asyncio.sleep(0)
        assert writer.transport.get_write_buffer_size() > 64 * 16_384 // 2
        writer.transport.abort()
    server.close()
