"""Sessions that lose their connection, and others that take them over."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from asyncua import ua

from benchmarks.wire import Wire
from hilserver.opcua import login
from tests.io.opcua_server.rig import Rig

pytestmark = pytest.mark.asyncio(loop_scope="module")


def session_of(rig: Rig, wire: Wire) -> Any:
    return rig.server._server.iserver.sessions[wire.authentication]


async def until(is_so: Callable[[], bool]) -> None:
    async with asyncio.timeout(60):
        while not is_so():  # noqa: ASYNC110
            await asyncio.sleep(0.01)


async def come_for_the_session(wire: Wire, of: Wire) -> None:
    """Open another channel for a session that exists."""
    await wire.greet()
    await wire.open()
    wire.authentication = of.authentication


async def test_a_session_that_ends_while_it_moves_stays_ended(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked, is_known = asyncio.Event(), asyncio.Event()
    identify = login.identify

    async def wait(*args: Any, **more: Any) -> Any:
        asked.set()
        await is_known.wait()
        return await identify(*args, **more)

    async with Wire(rig.server.url) as first, Wire(rig.server.url) as second:
        await first.log_in()
        session, sessions = session_of(rig, first), rig.server._server.iserver.sessions
        await come_for_the_session(second, first)
        monkeypatch.setattr(login, "identify", wait)
        moving = asyncio.create_task(second.activate_session())
        async with asyncio.timeout(60):
            await asked.wait()
        first.abort()
        await until(lambda: session.auth_token not in sessions)
        is_known.set()
        with pytest.raises(ua.uaerrors.BadSessionIdInvalid):
            await moving
        assert not session.is_activated
        assert session.processor is None
