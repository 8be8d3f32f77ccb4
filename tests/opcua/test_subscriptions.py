"""What UaExpert users would trip over: dead bands, queues, sampling, modification, pages."""

import asyncio
import time
from typing import Any

import pytest
from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.address_space import AttributeValue
from asyncua.ua.ua_binary import struct_from_binary
from hypothesis import given
from hypothesis import strategies as st

from hilserver.opcua.deadband import ChangeFilter, change_filter
from hilserver.opcua.encoding import FixedDataValue
from hilserver.opcua.items import ValueItem
from hilserver.opcua.monitored_items import GIVE_WAY_EVERY
from tests.io.opcua_server.rig import Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")
NODE = "tof.fl_m"
"""Its EURange is 0 .. 5 m."""


class Notes:
    """Values and status codes that a subscription delivers."""

    def __init__(self) -> None:
        self.values: list[Any] = []
        self.codes: list[int] = []
        self.news = asyncio.Event()

    def datachange_notification(self, node: object, value: object, data: Any) -> None:
        self.values.append(value)
        self.codes.append(data.monitored_item.Value.StatusCode.value)
        self.news.set()

    async def wait(self, count: int) -> list[Any]:
        async with asyncio.timeout(120):
            while len(self.values) < count:
                self.news.clear()
                await self.news.wait()
        return self.values


def item(
    client: RobotClient, path: str = NODE, **parameters: Any
) -> ua.MonitoredItemCreateRequest:
    request = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
    request.ItemToMonitor.NodeId = ua.NodeId(path, client.index)
    request.ItemToMonitor.AttributeId = ua.AttributeIds.Value
    request.RequestedParameters.DiscardOldest = True
    request.RequestedParameters.QueueSize = 100
    request.RequestedParameters.ClientHandle = 1
    for name, value in parameters.items():
        setattr(request.RequestedParameters, name, value)
    return request


def band(kind: int, size: float) -> ua.DataChangeFilter:
    return ua.DataChangeFilter(
        Trigger=ua.DataChangeTrigger.StatusValue, DeadbandType=kind, DeadbandValue=size
    )


async def monitor(
    client: RobotClient, interval_ms: float = 20, **parameters: Any
) -> tuple[Any, Notes, ua.MonitoredItemCreateResult]:
    notes = Notes()
    subscription = await client.create_subscription(interval_ms, notes)
    request = item(client, **parameters)
    mids = await subscription.create_monitored_items([request])
    assert isinstance(mids[0], int), mids
    return subscription, notes, mids[0]


async def create(client: RobotClient, request: Any) -> ua.MonitoredItemCreateResult:
    made = await client.create_subscription(1000, Notes())
    params = ua.CreateMonitoredItemsParameters(SubscriptionId=made.subscription_id)
    params.ItemsToCreate = [request]
    result = (await client.uaclient.create_monitored_items(params))[0]
    await made.delete()
    return result


async def test_absolute_dead_band_counts_from_the_last_report(
    rig: Rig, client: RobotClient
) -> None:
    """A drift in steps below the band is reported once it has gone far enough."""
    rig.set(NODE, 1.0)
    subscription, notes, _ = await monitor(
        client, Filter=band(1, 0.25), SamplingInterval=0.0
    )
    for i in range(1, 13):
        rig.set(NODE, 1.0 + i * 0.125)
    assert await notes.wait(5) == [1.0, 1.375, 1.75, 2.125, 2.5]
    await subscription.delete()


async def test_percent_dead_band_is_a_part_of_the_range(
    rig: Rig, client: RobotClient
) -> None:
    rig.set(NODE, 1.0)
    subscription, notes, _ = await monitor(
        client, Filter=band(2, 10.0), SamplingInterval=0.0
    )
    for value in (
        1.25,
        1.5,
        1.75,
        3.0,
    ):  # 10 % of 5 m is 0.5 m, which does not exceed it
        rig.set(NODE, value)
    assert await notes.wait(3) == [1.0, 1.75, 3.0]
    await subscription.delete()


@pytest.mark.parametrize(
    ("path", "filter_", "code"),
    [
        (NODE, band(1, -1.0), "BadDeadbandFilterInvalid"),
        (NODE, band(1, float("nan")), "BadDeadbandFilterInvalid"),
        (NODE, band(2, 101.0), "BadDeadbandFilterInvalid"),
        (NODE, band(7, 1.0), "BadDeadbandFilterInvalid"),
        (NODE, ua.EventFilter(), "BadFilterNotAllowed"),
        ("sim.realtime", band(2, 5.0), "BadNodeIdUnknown"),
        ("control.source", band(1, 1.0), "BadFilterNotAllowed"),
        ("drive.enable", band(2, 1.0), "BadFilterNotAllowed"),
    ],
)
async def test_filters_that_make_no_sense(
    client: RobotClient, path: str, filter_: Any, code: str
) -> None:
    result = await create(client, item(client, path, Filter=filter_))
    assert result.StatusCode.name == code


async def test_overflow_is_marked_beside_the_gap(rig: Rig, client: RobotClient) -> None:
    for discard_oldest, values, marked in (
        (True, [3.0, 4.0], 0),
        (False, [0.0, 4.0], 1),
    ):
        rig.set(NODE, 0.0)
        subscription, notes, _ = await monitor(
            client, 300, QueueSize=2, DiscardOldest=discard_oldest, SamplingInterval=0.0
        )
        for value in (1.0, 2.0, 3.0, 4.0):
            rig.set(NODE, value)
        assert (await notes.wait(2))[:2] == values
        assert [code & 0x480 for code in notes.codes[:2]] == [
            0x480 if position == marked else 0 for position in (0, 1)
        ]
        await subscription.delete()


async def test_queue_of_one_has_no_overflow_bit(rig: Rig, client: RobotClient) -> None:
    rig.set(NODE, 0.0)
    subscription, notes, _ = await monitor(
        client, 300, QueueSize=1, SamplingInterval=0.0
    )
    rig.set(NODE, 1.0)
    assert await notes.wait(1) == [1.0]
    assert notes.codes == [0]
    await subscription.delete()


@pytest.mark.parametrize(
    ("asked_ms", "granted_ms"),
    [(0.0, 0.0), (250.0, 250.0), (-1.0, 1000.0), (1e12, 3_600_000.0)],
)
async def test_sampling_interval_is_revised_honestly(
    client: RobotClient, asked_ms: float, granted_ms: float
) -> None:
    result = await create(client, item(client, SamplingInterval=asked_ms))
    assert result.RevisedSamplingInterval == granted_ms


async def test_modified_interval_holds_at_once(rig: Rig, client: RobotClient) -> None:
    rig.set(NODE, 0.0)
    subscription, notes, _ = await monitor(client, 3_000_000, SamplingInterval=0.0)
    params = ua.ModifySubscriptionParameters(
        SubscriptionId=subscription.subscription_id
    )
    params.RequestedPublishingInterval, params.RequestedMaxKeepAliveCount = 25.0, 10
    params.RequestedLifetimeCount = 5
    granted = await client.uaclient.modify_subscription(params)
    assert granted.RevisedPublishingInterval == 25.0
    assert (granted.RevisedMaxKeepAliveCount, granted.RevisedLifetimeCount) == (10, 30)
    rig.set(NODE, 2.0)
    assert (await notes.wait(2))[-1] == 2.0
    await subscription.delete()


async def test_no_more_notifications_than_asked_for(
    rig: Rig, client: RobotClient
) -> None:
    params = ua.CreateSubscriptionParameters(
        RequestedPublishingInterval=200.0, RequestedLifetimeCount=1000,
        RequestedMaxKeepAliveCount=100, MaxNotificationsPerPublish=3, PublishingEnabled=False,
    )  # fmt: skip
    sizes: list[tuple[int, bool]] = []

    class Spy(Notes):
        def datachange_notification(
            self, node: object, value: object, data: Any
        ) -> None:
            pass

    subscription = await client.create_subscription(params, Spy())
    publish = subscription.publish_callback

    async def spy(result: ua.PublishResult) -> None:
        parts = result.NotificationMessage.NotificationData
        sizes.append(
            (sum(len(part.MonitoredItems) for part in parts), result.MoreNotifications)
        )
        await publish(result)

    client.uaclient._subscription_callbacks[subscription.subscription_id] = spy
    rig.set(NODE, 0.0)
    await subscription.create_monitored_items([item(client, SamplingInterval=0.0)])
    for i in range(6):
        rig.set(NODE, 0.5 + i * 0.5)
    # All seven wait before the first is published, however slow the computer is.
    enable = ua.SetPublishingModeParameters(True, [subscription.subscription_id])
    await client.uaclient.set_publishing_mode(enable)
    async with asyncio.timeout(120):
        while sum(size for size, _ in sizes) < 7:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    assert [row for row in sizes if row[0]] == [(3, True), (3, True), (1, False)]
    await subscription.delete()


async def test_sampling_mode_queues_and_does_not_send(
    rig: Rig, client: RobotClient
) -> None:
    rig.set(NODE, 0.0)
    subscription, notes, mid = await monitor(client, SamplingInterval=0.0)
    await notes.wait(1)
    params = ua.SetMonitoringModeParameters(SubscriptionId=subscription.subscription_id)
    params.MonitoredItemIds, params.MonitoringMode = [mid], ua.MonitoringMode.Sampling
    await client.uaclient.set_monitoring_mode(params)
    rig.set(NODE, 1.5)
    await asyncio.sleep(0.1)
    assert notes.values == [0.0]
    params.MonitoringMode = ua.MonitoringMode.Reporting
    await client.uaclient.set_monitoring_mode(params)
    assert await notes.wait(2) == [0.0, 1.5]
    await subscription.delete()


@pytest.mark.parametrize("size", [1, 10])
async def test_a_sampled_item_is_sent_when_the_one_that_triggers_it_is(
    rig: Rig, client: RobotClient, size: int
) -> None:
    rig.set(NODE, 0.0)
    rig.set("tof.fr_m", 1.0)
    notes = Notes()
    subscription = await client.create_subscription(20, notes)
    trigger = item(client, QueueSize=size, SamplingInterval=0.0)
    linked = item(
        client, "tof.fr_m", QueueSize=size, SamplingInterval=0.0, ClientHandle=2
    )
    linked.MonitoringMode = ua.MonitoringMode.Sampling
    mids = await subscription.create_monitored_items([trigger, linked])
    assert await notes.wait(1) == [0.0]
    request = ua.SetTriggeringRequest()
    request.Parameters.SubscriptionId = subscription.subscription_id
    request.Parameters.TriggeringItemId, request.Parameters.LinksToAdd = (
        mids[0],
        [mids[1]],
    )
    data = await client.uaclient.protocol.send_request(request)
    answer = struct_from_binary(ua.SetTriggeringResponse, data)
    assert [code.name for code in answer.Parameters.AddResults] == ["Good"]
    rig.set("tof.fr_m", 2.0)
    await asyncio.sleep(0.1)
    assert notes.values == [0.0]
    rig.set(NODE, 0.5)
    assert sorted((await notes.wait(3 if size == 1 else 4))[1:]) in (
        [0.5, 2.0],
        [0.5, 1.0, 2.0],
    )
    await subscription.delete()


async def test_what_changes_during_a_look_in_portions_hides_no_item(
    rig: Rig, client: RobotClient
) -> None:
    rig.set(NODE, 1.0)
    subscription = await client.create_subscription(3_000_000, Notes())
    wanted = [item(client, QueueSize=1, SamplingInterval=0.0)] * (2 * GIVE_WAY_EVERY)
    first, *others = await subscription.create_monitored_items(wanted)
    service = rig.server._server.iserver.subscription_service
    items = service.subscriptions[subscription.subscription_id].items
    rig.set(NODE, 2.0)
    look = items.before_publishing(time.monotonic())
    next(look)
    items.delete(first)
    items.set_mode(others[-1], ua.MonitoringMode.Disabled)
    assert list(look) == [None]
    assert {items.get(number).seen.Value.Value for number in others[:-1]} == {2.0}
    assert others[-1] not in items.ready
    items.set_mode(others[-1], ua.MonitoringMode.Reporting)
    assert others[-1] in items.ready
    await subscription.delete()


async def test_browse_in_pages(client: RobotClient) -> None:
    description = ua.BrowseDescription(
        NodeId=ua.NodeId("robot", client.index), ResultMask=63
    )
    description.BrowseDirection = ua.BrowseDirection.Forward
    params = ua.BrowseParameters(NodesToBrowse=[description])
    (whole,) = await client.uaclient.browse(params)
    assert whole.ContinuationPoint is None
    params.RequestedMaxReferencesPerNode = 4
    (page,) = await client.uaclient.browse(params)
    found = list(page.References)
    while page.ContinuationPoint:
        point = page.ContinuationPoint
        (page,) = await client.uaclient.browse_next(
            ua.BrowseNextParameters(False, [point])
        )
        assert 0 < len(page.References) <= 4
        found += page.References
        (used,) = await client.uaclient.browse_next(
            ua.BrowseNextParameters(False, [point])
        )
        assert used.StatusCode.name == "BadContinuationPointInvalid"
    assert found == whole.References


async def test_too_many_operations(client: RobotClient) -> None:
    params = ua.ReadParameters()
    params.NodesToRead = [ua.ReadValueId(NodeId=ua.NodeId(NODE, client.index))] * 1001
    with pytest.raises(ua.uaerrors.BadTooManyOperations):
        await client.uaclient.read(params)
    limits = ua.ObjectIds.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead
    assert await client.get_node(ua.NodeId(limits)).read_value() == 1000


# --- properties -----------------------------------------------------------------------------------


def value_of(number: float) -> FixedDataValue:
    return FixedDataValue(ua.Variant(number, ua.VariantType.Double), ua.StatusCode(0))


def watching(place: Any, interval_ms: float, size: int = 1) -> ValueItem:
    return ValueItem(
        item_id=1,
        handle=b"\1\0\0\0",
        mode=ua.MonitoringMode.Reporting,
        size=size,
        discard_oldest=True,
        read=ua.ReadValueId(),
        place=place,
        stamps=ua.TimestampsToReturn.Both,
        change=ChangeFilter(),
        interval_s=interval_ms / 1e3,
    )


@given(
    st.lists(st.integers(-100, 100).map(float), min_size=1, max_size=60),
    st.integers(0, 20).map(float),
)
async def test_client_is_never_further_off_than_the_band(
    numbers: list[float], size: float
) -> None:
    change, reported = ChangeFilter(band=size), None
    for number in numbers:
        new = value_of(number)
        if change.is_worth_reporting(reported, new):
            if reported is not None:
                assert abs(number - reported.Value.Value) > size
            reported = new
        assert abs(number - reported.Value.Value) <= size


@given(
    st.lists(st.integers(1, 50), min_size=1, max_size=60),
    st.integers(1, 100),
)
async def test_an_item_looks_at_most_once_per_interval_and_the_last_value_gets_through(
    steps_ms: list[int], interval_ms: int
) -> None:
    place = AttributeValue(value_of(0.0))
    item, now_s, samples = watching(place, interval_ms), 1.0, []
    for step in steps_ms:
        place.value = value_of(now_s)
        if item.sample(place.value, now_s):
            samples.append(item.queue.popleft().Value.Value)
        last, now_s = now_s, now_s + step * 1e-3
    if item.sample(place.value, now_s + interval_ms * 1e-3):
        samples.append(item.queue.popleft().Value.Value)
    assert samples == sorted(set(samples))
    assert samples[0] == 1.0
    assert samples[-1] == last
    assert len(samples) <= (now_s - 1.0) / (interval_ms * 1e-3) + 2


async def test_percent_needs_a_range() -> None:
    with pytest.raises(ServiceError):
        change_filter(band(2, 1.0), 13, ua.VariantType.Double, None)
    found = change_filter(band(2, 1.0), 13, ua.VariantType.Double, ua.Range(-90, 90))
    assert found.band == pytest.approx(1.8)
