"""Floods of requests that a server has to withstand, each bounded and on loopback only."""

import asyncio
import contextlib
import itertools
import math
import struct
import time
from collections.abc import Awaitable, Callable

from asyncua import ua

from benchmarks.wire import Wire, frame

N_SOCKETS, N_SESSIONS = 300, 150
_PAUSE_S = 0.05
_REFUSED = (OSError, ua.UaError, TimeoutError)


async def _until(end_s: float, attack: Callable[[], Awaitable[None]]) -> None:
    """Attack repeatedly; a refusal is the server's correct answer."""
    while time.monotonic() < end_s:
        with contextlib.suppress(*_REFUSED):
            async with asyncio.timeout(max(0.1, end_s - time.monotonic())):
                await attack()
        await asyncio.sleep(_PAUSE_S)


async def idle_sockets(url: str, end_s: float) -> None:
    """Keep 300 silent sockets open."""

    async def hold() -> None:
        async with Wire(url) as wire:
            await wire.receive(within_s=60.0)

    await asyncio.gather(*(_until(end_s, hold) for _ in range(N_SOCKETS)))


async def sessions(url: str, end_s: float) -> None:
    """Keep 150 activated sessions open."""

    async def hold() -> None:
        async with Wire(url) as wire:
            await wire.log_in()
            await asyncio.sleep(60.0)

    await asyncio.gather(*(_until(end_s, hold) for _ in range(N_SESSIONS)))


async def deaf_consumer(url: str, end_s: float) -> None:
    """Request a lot and read none of it."""
    request = ua.BrowseRequest()
    description = ua.BrowseDescription(NodeId=ua.NodeId(ua.ObjectIds.BaseObjectType))
    description.ResultMask, description.BrowseDirection = 63, ua.BrowseDirection.Both
    request.Parameters.NodesToBrowse = [description] * 50

    async def ask() -> None:
        async with Wire(url) as wire:
            await wire.log_in()
            while True:
                await wire.send(wire.message(request))
                await asyncio.sleep(0.001)

    await _until(end_s, ask)


async def publishing_interval_zero(url: str, end_s: float) -> None:
    """Subscribe with intervals of 0, and keep the Publish requests coming."""

    async def subscribe() -> None:
        async with Wire(url) as wire:
            await wire.log_in()
            request = ua.CreateSubscriptionRequest()
            request.Parameters.RequestedPublishingInterval = 0.0
            request.Parameters.RequestedMaxKeepAliveCount = 1
            request.Parameters.PublishingEnabled = True
            made = await wire.ask(request, ua.CreateSubscriptionResponse)
            items = ua.CreateMonitoredItemsRequest()
            items.Parameters.SubscriptionId = made.Parameters.SubscriptionId
            item = ua.MonitoredItemCreateRequest(
                MonitoringMode=ua.MonitoringMode.Reporting
            )
            item.ItemToMonitor = ua.ReadValueId(
                NodeId=ua.NodeId("sim.tick", 2), AttributeId=ua.AttributeIds.Value
            )
            item.RequestedParameters.QueueSize = 2**32 - 1
            items.Parameters.ItemsToCreate = [item] * 50
            await wire.ask(items, ua.CreateMonitoredItemsResponse)
            for _ in range(5):
                await wire.send(wire.message(ua.PublishRequest()))
            while (await wire.receive())[0]:
                await wire.send(wire.message(ua.PublishRequest()))

    await asyncio.gather(*(_until(end_s, subscribe) for _ in range(4)))


async def two_gigabytes(url: str, end_s: float) -> None:
    """Announce 2 GB and start to send it."""

    async def announce() -> None:
        async with Wire(url) as wire:
            await wire.send(frame(b"MSG", b"", size=0x7FFF_FFFF))
            for _ in range(64):
                await wire.send(b"\0" * 2**20)

    await asyncio.gather(*(_until(end_s, announce) for _ in range(4)))


async def chunks(url: str, end_s: float) -> None:
    """Send chunk after chunk but never the last one, before and after the log-in."""

    async def flood(logged_in: bool) -> None:
        async with Wire(url) as wire:
            await wire.greet()
            await wire.open()
            if logged_in:
                await wire.create_session()
                await wire.activate_session()
            first = wire._sequence + 1
            for i in range(1000):
                head = struct.pack("<IIII", wire.channel, wire.token, first + i, first)
                await wire.send(frame(b"MSG", head + b"\0" * 65_000, b"C"))

    await asyncio.gather(
        *(_until(end_s, lambda when=i % 2 == 1: flood(when)) for i in range(4))  # type: ignore[misc]
    )


async def endless_sessions(url: str, end_s: float) -> None:
    """Create sessions whose time-out is not a number, and leave."""

    async def create() -> None:
        async with Wire(url) as wire:
            await wire.greet()
            await wire.open()
            request = ua.CreateSessionRequest()
            request.Parameters.RequestedSessionTimeout = math.nan
            request.Parameters.ClientNonce = b"\x01" * 32
            made = await wire.ask(request, ua.CreateSessionResponse)
            wire.authentication = made.Parameters.AuthenticationToken
            await wire.activate_session()
            await _subscribe(wire)

    await asyncio.gather(*(_until(end_s, create) for _ in range(8)))


async def orphans(url: str, end_s: float) -> None:
    """Leave as many subscriptions behind as the server permits."""

    async def leave() -> None:
        async with Wire(url) as wire:
            await wire.log_in()
            while True:
                await _subscribe(wire)

    await asyncio.gather(*(_until(end_s, leave) for _ in range(4)))


async def monitored_items(url: str, end_s: float) -> None:
    """Monitor as many items as the limits admit, at the highest rate, with the longest queues."""

    async def watch() -> None:
        async with Wire(url) as wire:
            await wire.log_in()
            numbers = [await _subscribe(wire, 0.0) for _ in range(10)]
            for number in itertools.cycle(numbers):
                items = ua.CreateMonitoredItemsRequest()
                items.Parameters.SubscriptionId = number
                items.Parameters.ItemsToCreate = [
                    _item(name, 1000) for name in _WATCHED
                ] * 5
                made = await wire.ask(items, ua.CreateMonitoredItemsResponse)
                if not made.Results[-1].StatusCode.is_good():
                    break
            for _ in range(15):
                await wire.send(wire.message(ua.PublishRequest()))
            while (await wire.receive())[0]:
                await wire.send(wire.message(ua.PublishRequest()))

    await asyncio.gather(*(_until(end_s, watch) for _ in range(3)))


async def numbers_that_are_none(url: str, end_s: float) -> None:
    """Ask for intervals, ages and dead bands that are not numbers."""

    async def ask() -> None:
        async with Wire(url) as wire:
            await wire.log_in()
            for number in (math.nan, math.inf, -math.inf):
                with contextlib.suppress(ua.UaError):
                    read = ua.ReadRequest()
                    read.Parameters.MaxAge = number
                    await wire.ask(read, ua.ReadResponse)
                items = ua.CreateMonitoredItemsRequest()
                items.Parameters.SubscriptionId = await _subscribe(wire, number)
                item = _item("sim.tick", 10)
                item.RequestedParameters.SamplingInterval = number
                items.Parameters.ItemsToCreate = [item]
                await wire.ask(items, ua.CreateMonitoredItemsResponse)

    await asyncio.gather(*(_until(end_s, ask) for _ in range(4)))


async def _subscribe(wire: Wire, interval_ms: float = 1000.0) -> int:
    request = ua.CreateSubscriptionRequest()
    request.Parameters.RequestedPublishingInterval = interval_ms
    request.Parameters.RequestedLifetimeCount = 10_000
    request.Parameters.PublishingEnabled = True
    made = await wire.ask(request, ua.CreateSubscriptionResponse)
    return int(made.Parameters.SubscriptionId)


_WATCHED = (
    "sim.tick",
    "sim.time_s",
    "pose.x_m",
    "pose.yaw_rad",
    "imu.gyro_z_rad_s",
) * 20


def _item(name: str, queue_size: int) -> ua.MonitoredItemCreateRequest:
    item = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
    item.ItemToMonitor = ua.ReadValueId(
        NodeId=ua.NodeId(name, 2), AttributeId=ua.AttributeIds.Value
    )
    item.RequestedParameters.QueueSize = queue_size
    return item


FLOODS: dict[str, Callable[[str, float], Awaitable[None]]] = {
    "300 idle sockets": idle_sockets,
    "150 sessions": sessions,
    "a consumer that stops reading": deaf_consumer,
    "publishing interval 0": publishing_interval_zero,
    "a header of 2 GB": two_gigabytes,
    "chunk floods": chunks,
    "sessions without end": endless_sessions,
    "orphaned subscriptions": orphans,
    "as many monitored items as there may be": monitored_items,
    "numbers that are none": numbers_that_are_none,
}
