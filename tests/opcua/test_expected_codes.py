"""The table of expected status codes, asked row by row over the wire."""

import math
import struct
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import Any

import pytest
import yaml
from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import struct_from_binary, struct_to_binary

from benchmarks.wire import Wire, frame, open_channel
from hilserver.opcua.encoding import ReadItem
from tests.io.opcua_server.rig import Rig

pytestmark = pytest.mark.asyncio(loop_scope="module")
TABLE = yaml.safe_load((Path(__file__).parent / "expected_codes.yaml").read_text())
PAGE = Path("docs/reference/opcua-conformance.md").read_text()
ROWS = [(service, case) for service, cases in TABLE.items() for case in cases]
Case = Callable[[Wire], Awaitable[str]]
CASES: dict[tuple[str, str], Case] = {}

VALUE = ua.AttributeIds.Value
NOWHERE = ua.NodeId("nowhere", 2)
NUMBER = ua.NodeId("pose.x_m", 2)
ARRAY = ua.NodeId("wheels.speeds_rpm", 2)
STRUCTURE = ua.NodeId("pose.x_m.EngineeringUnits", 2)


def case(service: str, name: str) -> Callable[[Case], Case]:
    def add(function: Case) -> Case:
        CASES[service, name] = function
        return function

    return add


async def fault(wire: Wire, request: Any, response: type) -> str:
    """Return the code of a service that fails as a whole."""
    try:
        await wire.ask(request, response)
    except ua.UaStatusCodeError as error:
        return ua.StatusCode(error.code).name
    return "Good"


# --- Read -----------------------------------------------------------------------------------------


def reading(item: ua.ReadValueId, count: int = 1) -> ua.ReadRequest:
    request = ua.ReadRequest()
    request.Parameters.NodesToRead = [item] * count
    return request


def value_of(node: ua.NodeId, **more: Any) -> ua.ReadValueId:
    return ua.ReadValueId(NodeId=node, AttributeId=VALUE, **more)


for name, make in {
    "no_nodes": lambda: reading(value_of(NUMBER), 0),
    "too_many_nodes": lambda: reading(value_of(NUMBER), 1001),
}.items():
    CASES["Read", name] = lambda wire, make=make: fault(wire, make(), ua.ReadResponse)

for name, age_ms in {"negative_age": -1.0, "age_nan": math.nan}.items():

    async def _age(wire: Wire, age_ms: float = age_ms) -> str:
        request = reading(value_of(NUMBER))
        request.Parameters.MaxAge = age_ms
        return await fault(wire, request, ua.ReadResponse)

    CASES["Read", name] = _age

for stamps in (4, 77):

    async def _stamps(wire: Wire, stamps: int = stamps) -> str:
        data = bytearray(struct_to_binary(reading(value_of(NUMBER)).Parameters))
        data[8:12] = struct.pack("<i", stamps)
        return await raw_fault(wire, ua.ReadRequest(), bytes(data))

    CASES["Read", f"stamps_{stamps}"] = _stamps

for name, item in {
    "unknown_node": value_of(NOWHERE),
    "unknown_attribute": ua.ReadValueId(NodeId=NUMBER, AttributeId=99),
    "range_of_array": value_of(ARRAY, IndexRange="1:2"),
    "range_beyond": value_of(ARRAY, IndexRange="9:12"),
    "range_backwards": value_of(ARRAY, IndexRange="2:1"),
    "range_same": value_of(ARRAY, IndexRange="1:1"),
    "range_text": value_of(ARRAY, IndexRange="abc"),
    "range_of_scalar": value_of(NUMBER, IndexRange="0"),
    "range_two_dimensions": value_of(ARRAY, IndexRange="0,0"),
    "encoding_of_scalar": value_of(
        NUMBER, DataEncoding=ua.QualifiedName("Default XML")
    ),
    "encoding_unknown": value_of(
        STRUCTURE, DataEncoding=ua.QualifiedName("Default Nonsense")
    ),
    "encoding_binary": value_of(
        STRUCTURE, DataEncoding=ua.QualifiedName("Default Binary")
    ),
}.items():

    async def _read(wire: Wire, item: ua.ReadValueId = item) -> str:
        (result,) = (await wire.ask(reading(item), ua.ReadResponse)).Results
        return result.StatusCode.name

    CASES["Read", name] = _read


async def raw_fault(wire: Wire, empty: Any, parameters: bytes) -> str:
    """Send a request whose parameters are given as bytes."""
    empty.RequestHeader.AuthenticationToken = wire.authentication
    whole = bytes(struct_to_binary(empty))
    tail = bytes(struct_to_binary(empty.Parameters))
    head = whole[: len(whole) - len(tail)]
    await wire.send(wire.message(head + parameters))
    _, body = await wire.receive()
    data = Buffer(body[16 + 4 :])
    header = struct_from_binary(ua.ResponseHeader, data)
    return header.ServiceResult.name


# --- views ----------------------------------------------------------------------------------------


async def browse(
    wire: Wire, *items: ua.BrowseDescription, view: ua.NodeId | None = None
) -> str:
    request = ua.BrowseRequest()
    request.Parameters.NodesToBrowse = list(items)
    if view is not None:
        request.Parameters.View.ViewId = view
    try:
        response = await wire.ask(request, ua.BrowseResponse)
    except ua.UaStatusCodeError as error:
        return ua.StatusCode(error.code).name
    return response.Results[-1].StatusCode.name


async def browse_directions(wire: Wire, *directions: int) -> list[str]:
    request = ua.BrowseRequest()
    request.Parameters.NodesToBrowse = [
        ua.BrowseDescription(NodeId=NUMBER, ResultMask=63) for _ in directions
    ]
    data = bytearray(struct_to_binary(request.Parameters))
    node = bytes(struct_to_binary(request.Parameters.NodesToBrowse[0]))
    for number, direction in enumerate(directions):
        start = len(data) - (len(directions) - number) * len(node)
        place = start + len(node) - 4 - 4 - 1 - 2 - 4
        data[place : place + 4] = struct.pack("<i", direction)
    request.RequestHeader.AuthenticationToken = wire.authentication
    whole, tail = (
        bytes(struct_to_binary(request)),
        bytes(struct_to_binary(request.Parameters)),
    )
    await wire.send(wire.message(whole[: len(whole) - len(tail)] + bytes(data)))
    _, body = await wire.receive()
    response = struct_from_binary(ua.BrowseResponse, Buffer(body[16:]))
    return [result.StatusCode.name for result in response.Results]


@case("Browse", "bad_direction")
async def _bad_direction(wire: Wire) -> str:
    return (await browse_directions(wire, 9))[0]


@case("Browse", "good_beside_bad_direction")
async def _beside(wire: Wire) -> str:
    return (await browse_directions(wire, 9, 0))[1]


CASES |= {
    ("Browse", "no_nodes"): browse,
    ("Browse", "unknown_node"): lambda wire: browse(
        wire, ua.BrowseDescription(NodeId=NOWHERE)
    ),
    ("Browse", "reference_type_unknown"): lambda wire: browse(
        wire, ua.BrowseDescription(NodeId=NUMBER, ReferenceTypeId=NOWHERE)
    ),
    ("Browse", "reference_type_object"): lambda wire: browse(
        wire,
        ua.BrowseDescription(
            NodeId=NUMBER, ReferenceTypeId=ua.NodeId(ua.ObjectIds.ObjectsFolder)
        ),
    ),
    ("Browse", "view"): lambda wire: browse(
        wire, ua.BrowseDescription(NodeId=NUMBER), view=NOWHERE
    ),
}


async def register(wire: Wire, count: int) -> str:
    request = ua.RegisterNodesRequest()
    request.Parameters.NodesToRegister = [NUMBER] * count
    return await fault(wire, request, ua.RegisterNodesResponse)


async def translate(wire: Wire, start: ua.NodeId, *names: str) -> str:
    request = ua.TranslateBrowsePathsToNodeIdsRequest()
    path = ua.BrowsePath(StartingNode=start)
    path.RelativePath.Elements = [
        ua.RelativePathElement(TargetName=ua.QualifiedName(name)) for name in names
    ]
    request.Parameters.BrowsePaths = [path]
    response = await wire.ask(request, ua.TranslateBrowsePathsToNodeIdsResponse)
    return response.Results[0].StatusCode.name


CASES |= {
    ("RegisterNodes", "no_nodes"): lambda wire: register(wire, 0),
    ("RegisterNodes", "too_many"): lambda wire: register(wire, 1001),
    ("UnregisterNodes", "no_nodes"): lambda wire: fault(
        wire, ua.UnregisterNodesRequest(), ua.UnregisterNodesResponse
    ),
    ("TranslateBrowsePathsToNodeIds", "unknown_start"): lambda wire: translate(
        wire, NOWHERE, "a"
    ),
    ("TranslateBrowsePathsToNodeIds", "no_elements"): lambda wire: translate(
        wire, NUMBER
    ),
    ("TranslateBrowsePathsToNodeIds", "no_match"): lambda wire: translate(
        wire, NUMBER, "a"
    ),
}


# --- subscriptions and items ----------------------------------------------------------------------


async def subscription(wire: Wire) -> int:
    request = ua.CreateSubscriptionRequest()
    request.Parameters.RequestedPublishingInterval = 1000.0
    made = await wire.ask(request, ua.CreateSubscriptionResponse)
    return int(made.Parameters.SubscriptionId)


def item_of(item: ua.ReadValueId, wanted: Any = None) -> ua.MonitoredItemCreateRequest:
    made = ua.MonitoredItemCreateRequest(MonitoringMode=ua.MonitoringMode.Reporting)
    made.ItemToMonitor = item
    made.RequestedParameters.Filter = wanted
    return made


async def items(wire: Wire, *wanted: Any, number: int | None = None) -> str:
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = number or await subscription(wire)
    request.Parameters.ItemsToCreate = list(wanted)
    try:
        response = await wire.ask(request, ua.CreateMonitoredItemsResponse)
    except ua.UaStatusCodeError as error:
        return ua.StatusCode(error.code).name
    return response.Results[0].StatusCode.name


@case("CreateMonitoredItems", "stamps_77")
async def _item_stamps(wire: Wire) -> str:
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = await subscription(wire)
    request.Parameters.ItemsToCreate = [item_of(value_of(NUMBER))]
    data = bytearray(struct_to_binary(request.Parameters))
    data[4:8] = struct.pack("<i", 77)
    return await raw_fault(wire, ua.CreateMonitoredItemsRequest(), bytes(data))


@case("CreateMonitoredItems", "bad_mode")
async def _item_mode(wire: Wire) -> str:
    request = ua.CreateMonitoredItemsRequest()
    number = request.Parameters.SubscriptionId = await subscription(wire)
    request.Parameters.ItemsToCreate = [item_of(value_of(NUMBER))]
    data = bytes(struct_to_binary(request.Parameters))
    read = bytes(struct_to_binary(value_of(NUMBER)))
    place = data.index(read) + len(read)
    data = data[:place] + struct.pack("<i", 9) + data[place + 4 :]
    empty = ua.CreateMonitoredItemsRequest()
    empty.RequestHeader.AuthenticationToken = wire.authentication
    whole, tail = (
        bytes(struct_to_binary(empty)),
        bytes(struct_to_binary(empty.Parameters)),
    )
    await wire.send(wire.message(whole[: len(whole) - len(tail)] + data))
    _, body = await wire.receive()
    response = struct_from_binary(ua.CreateMonitoredItemsResponse, Buffer(body[16:]))
    assert number
    return response.Results[0].StatusCode.name


@case("CreateMonitoredItems", "bad_trigger")
async def _item_trigger(wire: Wire) -> str:
    wanted = ua.DataChangeFilter(Trigger=ua.DataChangeTrigger.StatusValueTimestamp)
    request = ua.CreateMonitoredItemsRequest()
    request.Parameters.SubscriptionId = await subscription(wire)
    request.Parameters.ItemsToCreate = [item_of(value_of(NUMBER), wanted)]
    data = bytes(struct_to_binary(request.Parameters))
    place = data.index(b"\x01\x00\xd4\x02\x01") + 9  # DataChangeFilter
    data = data[:place] + struct.pack("<i", 9) + data[place + 4 :]
    empty = ua.CreateMonitoredItemsRequest()
    empty.RequestHeader.AuthenticationToken = wire.authentication
    whole, tail = (
        bytes(struct_to_binary(empty)),
        bytes(struct_to_binary(empty.Parameters)),
    )
    await wire.send(wire.message(whole[: len(whole) - len(tail)] + data))
    _, body = await wire.receive()
    response = struct_from_binary(ua.CreateMonitoredItemsResponse, Buffer(body[16:]))
    return response.Results[0].StatusCode.name


def events_of(node: ua.NodeId, clauses: int) -> ua.MonitoredItemCreateRequest:
    item = ua.ReadValueId(NodeId=node, AttributeId=ua.AttributeIds.EventNotifier)
    wanted = ua.EventFilter()
    wanted.SelectClauses = [ua.SimpleAttributeOperand()] * clauses
    return item_of(item, wanted)


CASES |= {
    ("CreateMonitoredItems", "no_items"): items,
    ("CreateMonitoredItems", "unknown_subscription"): lambda wire: items(
        wire, item_of(value_of(NUMBER)), number=4711
    ),
    ("CreateMonitoredItems", "range_of_scalar"): lambda wire: items(
        wire, item_of(value_of(NUMBER, IndexRange="0"))
    ),
    ("CreateMonitoredItems", "range_of_array"): lambda wire: items(
        wire, item_of(value_of(ARRAY, IndexRange="1:2"))
    ),
    ("CreateMonitoredItems", "encoding_of_scalar"): lambda wire: items(
        wire, item_of(value_of(NUMBER, DataEncoding=ua.QualifiedName("Default XML")))
    ),
    ("CreateMonitoredItems", "events_without_clauses"): lambda wire: items(
        wire, events_of(ua.NodeId(ua.ObjectIds.Server), 0)
    ),
    ("CreateMonitoredItems", "events_of_a_variable"): lambda wire: items(
        wire, events_of(NUMBER, 1)
    ),
}


@case("SetMonitoringMode", "bad_mode")
async def _mode(wire: Wire) -> str:
    data = struct.pack("<IiiI", await subscription(wire), 9, 1, 1)
    return await raw_fault(wire, ua.SetMonitoringModeRequest(), data)


@case("SetMonitoringMode", "unknown_item")
async def _mode_of_unknown(wire: Wire) -> str:
    request = ua.SetMonitoringModeRequest()
    request.Parameters.SubscriptionId = await subscription(wire)
    request.Parameters.MonitoredItemIds = [4711]
    response = await wire.ask(request, ua.SetMonitoringModeResponse)
    return response.Parameters.Results[0].name


async def trigger(wire: Wire, item_id: int | None, *links: int) -> str:
    request = ua.SetTriggeringRequest()
    number = request.Parameters.SubscriptionId = await subscription(wire)
    create = ua.CreateMonitoredItemsRequest()
    create.Parameters.SubscriptionId = number
    create.Parameters.ItemsToCreate = [item_of(value_of(NUMBER))]
    made = (await wire.ask(create, ua.CreateMonitoredItemsResponse)).Results[0]
    request.Parameters.TriggeringItemId = item_id or made.MonitoredItemId
    request.Parameters.LinksToAdd = list(links)
    try:
        response = await wire.ask(request, ua.SetTriggeringResponse)
    except ua.UaStatusCodeError as error:
        return ua.StatusCode(error.code).name
    return response.Parameters.AddResults[0].name


async def transfer(wire: Wire, number: int) -> str:
    request = ua.TransferSubscriptionsRequest()
    request.Parameters.SubscriptionIds = [number]
    response = await wire.ask(request, ua.TransferSubscriptionsResponse)
    return response.Parameters.Results[0].StatusCode.name


CASES |= {
    ("SetTriggering", "unknown_trigger"): lambda wire: trigger(wire, 4711, 1),
    ("SetTriggering", "unknown_link"): lambda wire: trigger(wire, None, 4711),
    ("SetTriggering", "nothing"): lambda wire: trigger(wire, None),
    ("TransferSubscriptions", "unknown"): lambda wire: transfer(wire, 4711),
    ("Publish", "no_subscription"): lambda wire: fault(
        wire, ua.PublishRequest(), ua.PublishResponse
    ),
}


@case("TransferSubscriptions", "anonymous")
async def _own(wire: Wire) -> str:
    return await transfer(wire, await subscription(wire))


@case("Republish", "unknown_message")
async def _republish(wire: Wire) -> str:
    request = ua.RepublishRequest()
    request.Parameters.SubscriptionId = await subscription(wire)
    request.Parameters.RetransmitSequenceNumber = 4711
    return await fault(wire, request, ua.RepublishResponse)


async def call(
    wire: Wire, method: ua.NodeId, *arguments: ua.Variant
) -> ua.CallMethodResult:
    request = ua.CallRequest()
    request.Parameters.MethodsToCall = [
        ua.CallMethodRequest(ua.NodeId(ua.ObjectIds.Server), method, list(arguments))
    ]
    return (await wire.ask(request, ua.CallResponse)).Results[0]


_GET = ua.NodeId(ua.ObjectIds.Server_GetMonitoredItems)


@case("Call", "get_monitored_items")
async def _get(wire: Wire) -> str:
    number = await subscription(wire)
    assert await items(wire, item_of(value_of(NUMBER)), number=number) == "Good"
    result = await call(wire, _GET, ua.Variant(number, ua.VariantType.UInt32))
    assert [len(argument.Value) for argument in result.OutputArguments] == [1, 1]
    return result.StatusCode.name


@case("Call", "get_monitored_items_of_others")
async def _get_others(wire: Wire) -> str:
    return (
        await call(wire, _GET, ua.Variant(4711, ua.VariantType.UInt32))
    ).StatusCode.name


@case("Call", "unknown_method")
async def _unknown_method(wire: Wire) -> str:
    return (await call(wire, NOWHERE)).StatusCode.name


# --- sessions and channels ------------------------------------------------------------------------


@case("CreateSession", "junk")
async def _junk(wire: Wire) -> str:
    return await raw_fault(wire, ua.CreateSessionRequest(), b"\xff\x13\x37" * 40)


@case("CreateSession", "second")
async def _second(wire: Wire) -> str:
    return await fault(wire, ua.CreateSessionRequest(), ua.CreateSessionResponse)


@case("ActivateSession", "unknown_token")
async def _unknown_token(wire: Wire) -> str:
    wire.authentication = ua.NodeId(b"x" * 32, 0, ua.NodeIdType.ByteString)
    return await fault(wire, ua.ActivateSessionRequest(), ua.ActivateSessionResponse)


async def error_after(wire: Wire, data: bytes) -> str:
    await wire.send(data)
    while True:
        kind, body = await wire.receive()
        if kind != b"MSG":
            return (
                ua.StatusCode(*struct.unpack_from("<I", body)).name
                if kind == b"ERR"
                else "none"
            )


def renumbered(
    data: bytes, channel: int = 0, token: int = 0, sequence: int = 0
) -> bytes:
    numbers = struct.unpack_from("<III", data, 8)
    moved = [n + by for n, by in zip(numbers, (channel, token, sequence), strict=True)]
    return data[:8] + struct.pack("<III", *moved) + data[20:]


@case("SecureChannel", "replayed")
async def _replayed(wire: Wire) -> str:
    message = wire.message(reading(value_of(NUMBER)))
    return await error_after(wire, message + message)


for name, moved in {
    "wrong_channel": {"channel": 1},
    "wrong_token": {"token": 1},
    "skipped": {"sequence": 5},
}.items():

    async def _moved(wire: Wire, moved: dict[str, int] = moved) -> str:
        return await error_after(
            wire, renumbered(wire.message(reading(value_of(NUMBER))), **moved)
        )

    CASES["SecureChannel", name] = _moved


async def opened_again(
    wire: Wire, channel: int, kind: ua.SecurityTokenRequestType
) -> str:
    data = open_channel(wire._sequence + 1)[8:]
    body = data[:4] + data[4:]
    request = ua.OpenSecureChannelRequest()
    request.Parameters.RequestType = kind
    request.Parameters.SecurityMode = ua.MessageSecurityMode.None_
    request.Parameters.ClientNonce = b""
    head = body[
        : 4 + 4 + len("http://opcfoundation.org/UA/SecurityPolicy#None") + 8 + 8
    ]
    head = struct.pack("<I", channel) + head[4:]
    return await error_after(
        wire, frame(b"OPN", head + bytes(struct_to_binary(request)))
    )


CASES |= {
    ("SecureChannel", "renewed_elsewhere"): lambda wire: opened_again(
        wire, wire.channel + 1, ua.SecurityTokenRequestType.Renew
    ),
    ("SecureChannel", "issued_twice"): lambda wire: opened_again(
        wire, wire.channel, ua.SecurityTokenRequestType.Issue
    ),
}


# --- the tests ------------------------------------------------------------------------------------


@pytest.mark.parametrize(("service", "name"), ROWS)
async def test_the_code_is_the_expected_one(rig: Rig, service: str, name: str) -> None:
    rig.tick()
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        assert await CASES[service, name](wire) == TABLE[service][name]["code"]


async def test_every_case_is_in_the_table() -> None:
    assert set(CASES) == set(ROWS)


async def test_the_page_shows_the_table() -> None:
    rows = [
        f"| {service} | {row['asks']} | {row['code']} |"
        for service, cases in TABLE.items()
        for row in cases.values()
    ]
    assert [row for row in rows if row not in PAGE] == []


async def test_a_part_of_an_array_is_that_part(rig: Rig) -> None:
    rig.gate.write("peer:a", {"wheel.rl.setpoint_rpm": 12.0})
    rig.tick()
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        request = reading(value_of(ARRAY, IndexRange="1:2"))
        (result,) = (await wire.ask(request, ua.ReadResponse)).Results
        assert result.Value.Value == [12.0, 0.0]


@pytest.mark.parametrize("stamps", list(ua.TimestampsToReturn)[:4])
async def test_only_the_stamps_that_are_asked_for(
    rig: Rig, stamps: ua.TimestampsToReturn
) -> None:
    rig.tick()
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        request = reading(value_of(NUMBER))
        request.Parameters.TimestampsToReturn = stamps
        (result,) = (await wire.ask(request, ua.ReadResponse)).Results
        found = (result.SourceTimestamp is not None, result.ServerTimestamp is not None)
        wanted = ua.TimestampsToReturn
        assert found == (
            stamps in (wanted.Source, wanted.Both),
            stamps in (wanted.Server, wanted.Both),
        )


async def test_result_mask_leaves_out_what_is_not_asked_for(rig: Rig) -> None:
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        request = ua.BrowseRequest()
        mask = int(ua.BrowseResultMask.BrowseName)
        request.Parameters.NodesToBrowse = [
            ua.BrowseDescription(NodeId=NUMBER, ResultMask=mask)
        ]
        (result,) = (await wire.ask(request, ua.BrowseResponse)).Results
        for reference in result.References:
            assert reference.BrowseName.Name
            assert reference.DisplayName.Text is None
            assert reference.TypeDefinition.is_null()


async def test_control_source_is_read_right_after_a_good_write(rig: Rig) -> None:
    rig.gate.request("peer", "peer")
    async with Wire(rig.server.url) as wire:
        await wire.log_in()
        source = ua.NodeId("control.source", 2)
        assert await wire.write(source, "opcua", ua.VariantType.String) == "Good"
        assert (await wire.read(source))[0].Value.Value == "opcua"


async def test_no_variable_is_null_and_good_or_without_stamps(rig: Rig) -> None:
    """Of all variables, those of the standard address space included."""
    space = rig.server._server.iserver.aspace
    nodes = [
        node_id
        for node_id in list(space.keys())
        if space[node_id].attributes[ua.AttributeIds.NodeClass].value.Value.Value
        == ua.NodeClass.Variable
    ]
    assert len(nodes) > 2000
    reader, wrong = rig.server._server.iserver.reader, []
    for node_id in nodes:
        value = reader.read(ReadItem(node_id, VALUE, "", ua.QualifiedName()), None)
        is_null = value.Value is None or value.Value.VariantType is ua.VariantType.Null
        if (is_null and not value.StatusCode.is_bad()) or value.ServerTimestamp is None:
            wrong.append(node_id)
    assert wrong == []
