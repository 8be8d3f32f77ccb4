"""Sessions that lose their connection, and others that take them over."""

import asyncio
from collections.abc import Callable
from typing import Any

import pytest
from asyncua import ua

from benchmarks.wire import Wire
from hilserver.opcua import login, rotation
from hilserver.opcua.monitored_items import MonitoredItems
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


NODE = ua.NodeId("tof.fl_m", 2)
ASKED, MADE = 100, 3


async def create_some(wire: Wire) -> int:
    """Create a subscription and ask for items of it, without waiting for the answer."""
    made = ua.CreateSubscriptionRequest()
    made.Parameters.RequestedPublishingInterval = 20.0
    made.Parameters.PublishingEnabled = True
    answer = await wire.ask(made, ua.CreateSubscriptionResponse)
    request = ua.CreateMonitoredItemsRequest()
    number = request.Parameters.SubscriptionId = answer.Parameters.SubscriptionId
    request.Parameters.ItemsToCreate = [
        ua.MonitoredItemCreateRequest(
            ua.ReadValueId(NODE, ua.AttributeIds.Value), ua.MonitoringMode.Reporting
        )
    ] * ASKED
    await wire.send(wire.message(request))
    return int(number)


async def published(wire: Wire) -> list[float]:
    answer = await wire.ask(ua.PublishRequest(), ua.PublishResponse)
    (change,) = answer.Parameters.NotificationMessage.NotificationData
    return [item.Value.Value.Value for item in change.MonitoredItems]


async def test_items_of_a_request_that_lost_its_connection_are_sampled(
    rig: Rig, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig.set("tof.fl_m", 1.0)
    create = MonitoredItems.create

    async with Wire(rig.server.url) as first, Wire(rig.server.url) as second:
        await first.log_in()
        session = session_of(rig, first)

        def lose(items: MonitoredItems, *args: Any) -> Any:
            result = create(items, *args)
            if len(items) == MADE:
                session.processor._transport.abort()
            return result

        with monkeypatch.context() as patched:
            patched.setattr(MonitoredItems, "create", lose)
            # one operation in a turn, and the event loop after each
            patched.setattr(rotation, "PORTION_S", 0.0)
            patched.setattr(rotation, "BUDGET_S", 1e-6)
            number = await create_some(first)
            await until(lambda: session.processor is None)
        made = len(session.own(number).items)
        assert MADE <= made < ASKED
        await come_for_the_session(second, first)
        await second.activate_session()
        assert await published(second) == [1.0] * made
        rig.set("tof.fl_m", 2.0)
        assert await published(second) == [2.0] * made
