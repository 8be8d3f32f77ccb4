"""Where clauses: refused when they are created, or as cheap as they are long."""

import asyncio
from typing import Any

import pytest
from asyncua import ua
from asyncua.common.utils import ServiceError
from hypothesis import given
from hypothesis import strategies as st

from hilserver.core.events import Event, EventKind
from hilserver.opcua.browsing import TypeTree
from hilserver.opcua.items import FixedEvent
from hilserver.opcua.where import MAX_DEPTH, MAX_ELEMENTS, compile_where
from tests.io.opcua_server.rig import Rig, RobotClient

Op = ua.FilterOperator
EVENT = FixedEvent(
    ua.NodeId(ua.ObjectIds.Server),
    {
        "Severity": ua.Variant(500, ua.VariantType.UInt16),
        "Kind": ua.Variant("state", ua.VariantType.String),
        "EventType": ua.Variant(ua.NodeId(2), ua.VariantType.NodeId),
    },
)


class Reference:
    IsForward, ReferenceTypeId = True, ua.NodeId(ua.ObjectIds.HasSubtype)

    def __init__(self, target: int) -> None:
        self.NodeId = ua.NodeId(target)


class Node:
    def __init__(self, *targets: int) -> None:
        self.references = [Reference(target) for target in targets]


class Space(dict):
    """Types 1 > 2 > 3 > 1: a tree of types that goes round."""

    def __init__(self) -> None:
        super().__init__(
            {ua.NodeId(1): Node(2), ua.NodeId(2): Node(3), ua.NodeId(3): Node(1)}
        )
        self._nodes = self


TYPES = TypeTree(Space())


def field(name: str) -> ua.SimpleAttributeOperand:
    return ua.SimpleAttributeOperand(BrowsePath=[ua.QualifiedName(name)])


def literal(value: Any) -> ua.LiteralOperand:
    return ua.LiteralOperand(ua.Variant(value))


def clause(*elements: tuple[Any, list[Any]]) -> ua.ContentFilter:
    return ua.ContentFilter(
        [ua.ContentFilterElement(op, operands) for op, operands in elements]
    )


def refusal(where: ua.ContentFilter) -> str:
    with pytest.raises(ServiceError) as error:
        compile_where(where, TYPES)
    return ua.StatusCode(error.value.code).name


def ors(count: int) -> ua.ContentFilter:
    """Each names the next one twice: 2^count evaluations."""
    rows = [
        (Op.Or, [ua.ElementOperand(i + 1), ua.ElementOperand(i + 1)])
        for i in range(count)
    ]
    return clause(*rows, (Op.Equals, [literal(1), literal(2)]))


def chain(count: int) -> ua.ContentFilter:
    rows = [(Op.Not, [ua.ElementOperand(i + 1)]) for i in range(count)]
    return clause(*rows, (Op.Equals, [literal(1), literal(1)]))


@pytest.mark.parametrize(
    ("where", "code"),
    [
        (ors(39), "BadEventFilterInvalid"),
        (clause((Op.Not, [ua.ElementOperand(0)])), "BadEventFilterInvalid"),
        (clause((Op.Not, [ua.ElementOperand(7)])), "BadEventFilterInvalid"),
        (clause((Op.Not, [ua.ElementOperand(1)]), (Op.Not, [ua.ElementOperand(0)])),
         "BadEventFilterInvalid"),
        (chain(MAX_DEPTH + 1), "BadEventFilterInvalid"),
        (clause(*[(Op.IsNull, [literal(1)])] * (MAX_ELEMENTS + 1)), "BadEventFilterInvalid"),
        (clause((Op.InList, [literal(1)] * 501)), "BadEventFilterInvalid"),
        (clause((Op.Equals, [literal(1)])), "BadFilterOperandCountMismatch"),
        (clause((Op.Like, [literal("a"), literal("b")])), "BadFilterOperatorUnsupported"),
        (clause((99, [literal("a"), literal("b")])), "BadFilterOperatorUnsupported"),
        (clause((Op.Not, [None])), "BadFilterOperandInvalid"),
    ],
)  # fmt: skip
def test_what_is_no_short_tree_is_refused(where: ua.ContentFilter, code: str) -> None:
    assert refusal(where) == code


@pytest.mark.parametrize(
    ("where", "passes"),
    [
        (clause(), True),
        (clause((Op.GreaterThanOrEqual, [field("Severity"), literal(500)])), True),
        (clause((Op.LessThan, [field("Severity"), literal(500)])), False),
        (clause((Op.Between, [field("Severity"), literal(400), literal(600)])), True),
        (clause((Op.InList, [field("Kind"), literal("x"), literal("state")])), True),
        (clause((Op.IsNull, [field("nothing")])), True),
        (clause((Op.GreaterThan, [field("Kind"), literal(1)])), False),
        (clause((Op.OfType, [literal(ua.NodeId(1))])), True),
        (clause((Op.OfType, [literal(ua.NodeId(9))])), False),
        (clause((Op.OfType, [literal([1])])), False),
        (chain(MAX_DEPTH - 1), False),
    ],
)
def test_what_passes(where: ua.ContentFilter, passes: bool) -> None:
    assert compile_where(where, TYPES)(EVENT) is passes


@given(
    st.lists(
        st.lists(st.integers(0, 12), min_size=2, max_size=2), min_size=1, max_size=10
    )
)
def test_whatever_is_accepted_costs_no_more_than_its_elements(
    rows: list[list[int]],
) -> None:
    looks = []

    class Counted(FixedEvent):
        def field(self, name: str) -> Any:
            looks.append(name)
            return None

    elements = [(Op.Or, [ua.ElementOperand(i) for i in row]) for row in rows]
    where = clause(*elements, *[(Op.Not, [field("x")])] * 3)
    try:
        compile_where(where, TYPES)(Counted(ua.NodeId(), {}))
    except ServiceError:
        return
    assert len(looks) <= len(where.Elements)


@pytest.mark.asyncio(loop_scope="module")
async def test_the_subtypes_of_a_type_pass_and_a_filter_of_the_attack_does_not_enter(
    rig: Rig, client: RobotClient
) -> None:
    class Inbox:
        def event_notification(self, event: Any) -> None:
            found.append(event)

    found: list[Any] = []
    subscription = await client.create_subscription(10, Inbox())
    item = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
    item.ItemToMonitor = ua.ReadValueId(
        ua.NodeId(ua.ObjectIds.Server), ua.AttributeIds.EventNotifier
    )
    base = literal(ua.NodeId(ua.ObjectIds.BaseEventType))
    selected = [ua.SimpleAttributeOperand(
        TypeDefinitionId=ua.NodeId(ua.ObjectIds.BaseEventType),
        BrowsePath=[ua.QualifiedName("Message")], AttributeId=ua.AttributeIds.Value,
    )]  # fmt: skip
    params = ua.CreateMonitoredItemsParameters(
        SubscriptionId=subscription.subscription_id
    )
    for where, code in (
        (clause((Op.OfType, [base])), "Good"),
        (ors(39), "BadEventFilterInvalid"),
    ):
        item.RequestedParameters.Filter = ua.EventFilter(selected, where)
        params.ItemsToCreate = [item]
        (result,) = await client.uaclient.create_monitored_items(params)
        assert result.StatusCode.name == code
    publish = client.uaclient._subscription_callbacks[subscription.subscription_id]
    sizes: list[int] = []

    async def spy(result: ua.PublishResult) -> None:
        sizes.extend(len(p.Events) for p in result.NotificationMessage.NotificationData)
        await publish(result)

    client.uaclient._subscription_callbacks[subscription.subscription_id] = spy
    rig.events.publish(Event(EventKind.STATE, 1, "daemon", "hello"))
    async with asyncio.timeout(60):
        while not sizes:  # noqa: ASYNC110
            await asyncio.sleep(0.01)
    assert sizes == [1]
    await subscription.delete()
