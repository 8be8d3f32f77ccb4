"""Events: types, fields, both notifiers, floods."""

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import pytest
from asyncua import ua
from hypothesis import given
from hypothesis import strategies as st

from hilserver.core.events import Event, EventKind
from hilserver.io.opcua_server.robot_events import TYPE_NAMES, FloodGate
from tests.io.opcua_server.rig import Rig, RobotClient

pytestmark = pytest.mark.asyncio(loop_scope="module")


class Inbox:
    def __init__(self) -> None:
        self.events: asyncio.Queue[Any] = asyncio.Queue()

    def event_notification(self, event: Any) -> None:
        self.events.put_nowait(event)

    async def next(self) -> Any:
        return await asyncio.wait_for(self.events.get(), 60)


@asynccontextmanager
async def inbox(
    client: RobotClient, source: Any, event_type: Any
) -> AsyncIterator[Inbox]:
    box = Inbox()
    subscription = await client.create_subscription(10, box)
    await subscription.subscribe_events(source, event_type, queuesize=100)
    yield box
    await subscription.delete()


@pytest.mark.parametrize("kind", list(EventKind))
async def test_event_of_every_kind_reaches_server_and_robot(
    rig: Rig, client: RobotClient, kind: EventKind
) -> None:
    event_type = client.path(f"types.{TYPE_NAMES[kind]}")
    event = Event(kind, 700, "peer:plc", "something happened")
    async with (
        inbox(client, ua.ObjectIds.Server, event_type) as at_server,
        inbox(client, client.path("robot"), event_type) as at_robot,
    ):
        rig.events.publish(event)
        first, second = await at_server.next(), await at_robot.next()
    assert first.EventId == second.EventId
    assert first.EventType == event_type.nodeid
    assert (first.Severity, first.Message.Text) == (700, "something happened")
    assert (first.SourceName, first.SourceNode) == (
        "peer:plc",
        client.path("robot").nodeid,
    )
    assert first.Time == rig.clock.utc(event.monotonic_ns)
    assert (first.Kind, first.Suppressed) == (kind.value, 0)
    assert first.MonotonicTime_ns == event.monotonic_ns


async def test_refused_write_says_who_has_control(
    rig: Rig, client: RobotClient
) -> None:
    event_type = client.path("types.SetPointRefusedEventType")
    async with inbox(client, ua.ObjectIds.Server, event_type) as box:
        rig.gate.take("peer")
        await client.write_doubles(wheel__fl__setpoint_rpm=1.0)
        event = await box.next()
    assert "'peer' has control" in event.Message.Text


async def test_select_clauses_of_a_hostile_client(
    rig: Rig, client: RobotClient
) -> None:
    """Names of Python attributes are no event fields, and break nothing."""
    event_filter = ua.EventFilter()
    for name in ("__class__", "to_event_fields", "Message", "", "_fields"):
        clause = ua.SimpleAttributeOperand()
        clause.TypeDefinitionId = ua.NodeId(ua.ObjectIds.BaseEventType)
        clause.AttributeId = ua.AttributeIds.Value
        clause.BrowsePath = [ua.QualifiedName(name)] if name else []
        event_filter.SelectClauses.append(clause)
    item = ua.MonitoredItemCreateRequest()
    item.ItemToMonitor.NodeId = ua.NodeId(ua.ObjectIds.Server)
    item.ItemToMonitor.AttributeId = ua.AttributeIds.EventNotifier
    item.MonitoringMode = ua.MonitoringMode.Reporting
    item.RequestedParameters.Filter = event_filter
    item.RequestedParameters.QueueSize = 10
    subscription = await client.create_subscription(10, Inbox())
    params = ua.CreateMonitoredItemsParameters()
    params.SubscriptionId = subscription.subscription_id
    params.ItemsToCreate = [item]
    assert (await client.uaclient.create_monitored_items(params))[
        0
    ].StatusCode.is_good()
    async with inbox(
        client, ua.ObjectIds.Server, client.path("types.StateChangedEventType")
    ) as box:
        rig.events.publish(Event(EventKind.STATE, 1, "daemon", "still here"))
        assert (await box.next()).Message.Text == "still here"
    await subscription.delete()


async def test_floods_are_counted() -> None:
    """Of twelve events in a second ten are sent, and a summary stands for the other two."""
    now_s = [0.0]
    sent: list[tuple[str, int]] = []
    gate = FloodGate(
        10, lambda event, n: sent.append((event.message, n)), lambda: now_s[0]
    )
    for i in range(12):
        gate.send(Event(EventKind.OVERRUN, 1, "plant", f"overrun {i}"))
    gate.flush()
    assert sent == [(f"overrun {i}", 0) for i in range(10)]
    gate.send(Event(EventKind.STATE, 1, "daemon", "other kinds are not held back"))
    now_s[0] = 1.0
    gate.flush()
    gate.flush()
    assert sent[-2:] == [("other kinds are not held back", 0), ("overrun 11", 1)]
    gate.send(Event(EventKind.OVERRUN, 1, "plant", "later"))
    assert sent[-1] == ("later", 0)


@given(
    st.lists(st.tuples(st.sampled_from(EventKind), st.floats(0, 0.7)), max_size=60),
    st.integers(1, 4),
)
async def test_no_event_is_lost_from_the_count(
    steps: list[tuple[EventKind, float]], limit: int
) -> None:
    now_s = [0.0]
    sent: list[tuple[EventKind, float, int]] = []
    gate = FloodGate(
        limit, lambda event, n: sent.append((event.kind, now_s[0], n)), lambda: now_s[0]
    )
    for kind, wait_s in steps:
        now_s[0] += wait_s
        gate.send(Event(kind, 1, "x", "y"))
    now_s[0] += 2.0
    gate.flush()
    for kind in EventKind:
        of_kind = [(at_s, n) for k, at_s, n in sent if k is kind]
        assert sum(1 + n for _, n in of_kind) == sum(k is kind for k, _ in steps)
        windows = [
            sum(start <= at < start + 0.999 for at, _ in of_kind)
            for start, _ in of_kind
        ]
        assert max(windows, default=0) <= 2 * limit
