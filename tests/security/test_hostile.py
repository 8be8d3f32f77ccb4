"""What hostile clients tried: numbers that are none, more than their share, others' places."""

import asyncio
import math
import struct
from collections.abc import AsyncIterator

import pytest
import pytest_asyncio
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import struct_from_binary

from benchmarks.wire import Wire, frame
from hilserver.core.snapshot import MOST_SNAPSHOTS
from hilserver.faults.model import parse_faults
from hilserver.opcua.settings import OpcUaLimits, Role
from tests.io.opcua_server.rig import Rig, connected

pytestmark = pytest.mark.asyncio(loop_scope="module")
NO_NUMBERS = (math.nan, math.inf, -math.inf)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def rig(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    rig = Rig(tmp_path_factory.mktemp("snapshots"))
    await rig.server.start()
    rig.control.started()
    rig.gate.request("opcua", "opcua")
    rig.tick()
    yield rig
    await rig.close()


# --- numbers that are none ------------------------------------------------------------------------


@pytest.mark.parametrize("asked_ms", [*NO_NUMBERS, 1e300, -1.0])
async def test_a_session_ends_whatever_time_out_was_asked_for(
    rig: Rig, asked_ms: float
) -> None:
    async with Wire(rig.server.url) as wire:
        await wire.greet()
        await wire.open()
        request = ua.CreateSessionRequest()
        request.Parameters.RequestedSessionTimeout = asked_ms
        response = await wire.ask(request, ua.CreateSessionResponse)
        assert 1_000 <= response.Parameters.RevisedSessionTimeout <= 120_000


@pytest.mark.parametrize("asked", NO_NUMBERS)
async def test_intervals_that_are_no_numbers_are_revised(
    rig: Rig, asked: float
) -> None:
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        create = ua.CreateSubscriptionRequest()
        create.Parameters.RequestedPublishingInterval = asked
        made = (await wire.ask(create, ua.CreateSubscriptionResponse)).Parameters
        assert 5.0 <= made.RevisedPublishingInterval <= 3_600_000.0
        items = ua.CreateMonitoredItemsRequest()
        items.Parameters.SubscriptionId = made.SubscriptionId
        item = ua.MonitoredItemCreateRequest()
        item.ItemToMonitor = ua.ReadValueId(
            NodeId=ua.NodeId("sim.tick", 2), AttributeId=ua.AttributeIds.Value
        )
        item.RequestedParameters.SamplingInterval = asked
        items.Parameters.ItemsToCreate = [item]
        (result,) = (await wire.ask(items, ua.CreateMonitoredItemsResponse)).Results
        assert 0.0 <= result.RevisedSamplingInterval <= 3_600_000.0
        item.RequestedParameters.Filter = ua.DataChangeFilter(
            Trigger=ua.DataChangeTrigger.StatusValue,
            DeadbandType=ua.DeadbandType.Absolute,
            DeadbandValue=asked,
        )
        (result,) = (await wire.ask(items, ua.CreateMonitoredItemsResponse)).Results
        assert result.StatusCode.name == "BadDeadbandFilterInvalid"


@pytest.mark.parametrize("number", NO_NUMBERS)
async def test_methods_take_no_number_that_is_none(rig: Rig, number: float) -> None:
    async with connected(rig) as client:
        double = ua.Variant(number, ua.VariantType.Double)
        answer = await client.call("SetPose", double, double, double)
        assert answer.StatusCode.name == "BadInvalidArgument"
        signal = ua.Variant("wheel.fl.speed_rpm", ua.VariantType.String)
        answer = await client.call("Force", signal, double)
        assert answer.StatusCode.name in ("BadInvalidArgument", "BadNotImplemented")


@pytest.mark.parametrize("number", ["NaN", "Infinity", "-Infinity", "1e999"])
async def test_injected_faults_have_no_number_that_is_none(number: str) -> None:
    with pytest.raises(ValueError, match=r"offset|valid JSON"):
        parse_faults(f'{{"fault": "bias", "signal": "pose.x_m", "offset": {number}}}')


# --- more than their share ------------------------------------------------------------------------


async def subscribe(wire: Wire, count: int = 1) -> list[int]:
    """Create subscriptions; return their numbers."""
    request = ua.CreateSubscriptionRequest()
    request.Parameters.RequestedPublishingInterval = 1000.0
    request.Parameters.RequestedLifetimeCount = 1000
    request.Parameters.PublishingEnabled = True
    made = [
        await wire.ask(request, ua.CreateSubscriptionResponse) for _ in range(count)
    ]
    return [response.Parameters.SubscriptionId for response in made]


async def monitor(
    wire: Wire, number: int, count: int, queue_size: int, path: str = "sim.tick"
) -> list[ua.MonitoredItemCreateResult]:
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = number
    item = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
    item.ItemToMonitor = ua.ReadValueId(
        NodeId=ua.NodeId(path, 2), AttributeId=ua.AttributeIds.Value
    )
    item.RequestedParameters.QueueSize = queue_size
    request.Parameters.ItemsToCreate = [item] * count
    return list((await wire.ask(request, ua.CreateMonitoredItemsResponse)).Results)


@pytest_asyncio.fixture(scope="module", loop_scope="module")
async def tight(tmp_path_factory: pytest.TempPathFactory) -> AsyncIterator[Rig]:
    """A server with room for little."""
    share = {"subscriptions": 2, "monitored_items": 5, "queued_values": 12}
    rig = Rig(
        tmp_path_factory.mktemp("snapshots"),
        limits={"observer": share, "operator": share, "engineer": share},
        max_subscriptions=3,
        max_monitored_items=8,
        max_queued_values=15,
        max_sessions=3,
    )
    await rig.server.start()
    rig.tick()
    yield rig
    await rig.close()


async def test_a_session_has_no_more_subscriptions_than_its_role_may(
    tight: Rig,
) -> None:
    async with Wire(tight.server.url) as wire:
        await wire.log_in()
        await subscribe(wire, 2)
        with pytest.raises(ua.uaerrors.BadTooManySubscriptions):
            await subscribe(wire)


async def test_items_and_queues_have_a_common_bound(tight: Rig) -> None:
    async with Wire(tight.server.url) as wire:
        await wire.log_in()
        first, second = await subscribe(wire, 2)
        results = await monitor(wire, first, 3, 1000)
        assert [result.RevisedQueueSize for result in results] == [13, 1, 1]
        results = await monitor(wire, second, 3, 1000)
        codes = [result.StatusCode.name for result in results]
        assert codes == ["Good", "Good", "BadTooManyMonitoredItems"]
        service = tight.server._server.iserver.subscription_service
        assert sum(s.items.queued_values for s in service.subscriptions.values()) == 12


async def test_the_role_decides_how_much() -> None:
    limits = OpcUaLimits()
    shares = [limits.of(role) for role in Role]
    for name in ("subscriptions", "monitored_items", "queued_values"):
        sizes = [getattr(share, name) for share in shares]
        assert sizes == sorted(set(sizes))


async def orphaned(rig: Rig, count: int) -> list[int]:
    """Leave a session with subscriptions behind."""
    async with Wire(rig.server.url) as dead:
        await dead.log_in()
        numbers = await subscribe(dead, count)
    sessions = rig.server._server.iserver.sessions
    async with asyncio.timeout(120):
        while all(session.processor is not None for session in sessions.values()):  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    return numbers


async def test_what_a_dead_client_left_behind_yields_to_the_living(tight: Rig) -> None:
    (orphan, *_) = await orphaned(tight, 2)
    async with Wire(tight.server.url) as wire:
        await wire.log_in()
        await subscribe(wire, 2)
        service = tight.server._server.iserver.subscription_service
        assert len(service.subscriptions) == 3
        assert orphan not in service.subscriptions


async def test_sessions_of_dead_clients_yield_to_the_living(tight: Rig) -> None:
    for _ in range(4):
        await orphaned(tight, 1)
    async with Wire(tight.server.url) as wire:
        await wire.log_in()


# --- answers within what the client takes ---------------------------------------------------------


async def test_no_answer_is_longer_than_the_session_agreed(rig: Rig) -> None:
    async with Wire(rig.server.url) as wire:
        await wire.greet()
        await wire.open()
        request = ua.CreateSessionRequest()
        request.Parameters.MaxResponseMessageSize = 8192
        request.Parameters.ClientNonce = b"\x01" * 32
        made = await wire.ask(request, ua.CreateSessionResponse)
        wire.authentication = made.Parameters.AuthenticationToken
        await wire.activate_session()
        with pytest.raises(ua.uaerrors.BadResponseTooLarge):
            await wire.read(*[ua.NodeId("wheels.speeds_rpm", 2)] * 300)
        (number,) = await subscribe(wire)
        for _ in range(5):
            await monitor(wire, number, 100, 1, "wheels.speeds_rpm")
        received = 0
        while received < 500:
            await wire.send(wire.message(ua.PublishRequest()))
            kind, body = await wire.receive()
            assert (kind, len(body) <= 8192) == (b"MSG", True)
            data = Buffer(body[16:])
            response = struct_from_binary(ua.PublishResponse, data)
            (part,) = response.Parameters.NotificationMessage.NotificationData
            received += len(part.MonitoredItems)
            assert response.Parameters.MoreNotifications == (received < 500)


async def test_no_answer_has_more_chunks_than_the_client_takes(rig: Rig) -> None:
    async with Wire(rig.server.url) as wire:
        url = rig.server.url.encode()
        numbers = struct.pack("<IIIIIi", 0, 8192, 8192, 0, 1, len(url))
        await wire.send(frame(b"HEL", numbers + url))
        assert (await wire.receive())[0] == b"ACK"
        await wire.open()
        await wire.create_session()
        await wire.activate_session()
        with pytest.raises(ua.uaerrors.BadResponseTooLarge):
            await wire.read(*[ua.NodeId("wheels.speeds_rpm", 2)] * 300)


async def test_snapshots_do_not_fill_the_disk(rig: Rig) -> None:
    folder = rig.snapshots._folder
    for number in range(MOST_SNAPSHOTS):
        (folder / f"old{number}.npz").touch()
    async with connected(rig) as client:
        name = ua.Variant("one_more", ua.VariantType.String)
        answer = await client.call("SaveSnapshot", name)
        assert answer.StatusCode.name == "BadInvalidState"
    assert not (folder / "one_more.npz").exists()
    for path in folder.glob("old*.npz"):
        path.unlink()
