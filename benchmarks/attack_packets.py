"""Malformed OPC UA packets: valid captures, mutated by a seeded generator."""

import random
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary

from benchmarks.wire import frame, hello, open_channel

STAGES = ("raw", "hello", "channel", "session")
"""What precedes the packet: nothing, Hello, an open channel, an activated session."""
_HEAD = 24
_CAPTURED = datetime(2024, 1, 1, tzinfo=UTC)
_LENGTHS = (-1, 0, 1, -(2**31), 2**31 - 1, 2**16, 2**24)
_BYTES = (0x00, 0x01, 0x7F, 0x80, 0xFE, 0xFF)


@dataclass(frozen=True, slots=True)
class Packet:
    """One packet and the stage at which it is sent.

    Attributes
    ----------
    data : bytes
        A whole frame, or what a mutation left of it; channel, token and sequence numbers of a
        message are filled in when it is sent, unless the mutation hit them.
    keeps_head : bool
        Whether these numbers are to be filled in.
    """

    stage: str
    data: bytes
    keeps_head: bool


def captures() -> list[bytes]:
    """Return valid frames: Hello, OpenSecureChannel and one message per service."""
    url = "opc.tcp://127.0.0.1:4840/hilserver"
    messages = [frame(b"MSG", b"\0" * 16 + _encoded(r)) for r in requests()]
    close = _encoded(ua.CloseSecureChannelRequest())
    return [hello(url), open_channel(), frame(b"CLO", b"\0" * 16 + close), *messages]


def _encoded(request: Any) -> bytes:
    """Return a request as it would be captured at a fixed time."""
    request.RequestHeader.Timestamp = _CAPTURED
    return bytes(struct_to_binary(request))


def requests() -> list[object]:
    """Return one valid request of every service, including those that clients should not use."""
    node, value = ua.NodeId("wheel.fl.setpoint_rpm", 2), ua.AttributeIds.Value
    read = ua.ReadRequest()
    read.Parameters.NodesToRead = [ua.ReadValueId(NodeId=node, AttributeId=value)] * 4
    write = ua.WriteRequest()
    matrix = ua.Variant([[1.0, 2.0], [3.0, 4.0]], ua.VariantType.Double)
    write.Parameters.NodesToWrite = [
        ua.WriteValue(
            NodeId=node, AttributeId=value, Value=ua.DataValue(ua.Variant(content))
        )
        for content in (1.5, [1.0, 2.0], "text", [ua.Variant(1)], ua.LocalizedText("a"))
    ] + [ua.WriteValue(NodeId=node, AttributeId=value, Value=ua.DataValue(matrix))]
    call = ua.CallRequest()
    method = ua.CallMethodRequest(
        ua.NodeId("methods", 2), ua.NodeId("methods.SetPose", 2)
    )
    method.InputArguments = [ua.Variant(0.0)] * 3
    call.Parameters.MethodsToCall = [method]
    browse = ua.BrowseRequest()
    browse.Parameters.NodesToBrowse = [
        ua.BrowseDescription(NodeId=node, ResultMask=63)
    ] * 2
    browse.Parameters.View.Timestamp = _CAPTURED
    path = ua.BrowsePath(StartingNode=node)
    path.RelativePath.Elements = [
        ua.RelativePathElement(TargetName=ua.QualifiedName("EURange"))
    ]
    translate = ua.TranslateBrowsePathsToNodeIdsRequest()
    translate.Parameters.BrowsePaths = [path]
    subscribe = ua.CreateSubscriptionRequest()
    subscribe.Parameters.RequestedPublishingInterval = 100.0
    items = ua.CreateMonitoredItemsRequest()
    item = ua.MonitoredItemCreateRequest()
    item.ItemToMonitor = ua.ReadValueId(NodeId=node, AttributeId=value)
    item.RequestedParameters.Filter = ua.DataChangeFilter()
    events = ua.MonitoredItemCreateRequest()
    events.RequestedParameters.Filter = ua.EventFilter()
    items.Parameters.ItemsToCreate = [item, events]
    publish = ua.PublishRequest()
    publish.Parameters.SubscriptionAcknowledgements = [
        ua.SubscriptionAcknowledgement(1, 2)
    ]
    add = ua.AddNodesRequest()
    add.Parameters.NodesToAdd = [ua.AddNodesItem()]
    activate = ua.ActivateSessionRequest()
    activate.Parameters.UserIdentityToken = ua.UserNameIdentityToken(
        "p", "admin", b"x", ""
    )
    register = ua.RegisterServerRequest()
    register.Server.ServerNames = [ua.LocalizedText("x")]
    return [
        read, write, call, browse, translate, subscribe, items, publish, add, activate, register,
        ua.CreateSessionRequest(), ua.GetEndpointsRequest(), ua.FindServersRequest(),
        ua.BrowseNextRequest(), ua.ModifySubscriptionRequest(), ua.DeleteSubscriptionsRequest(),
        ua.ModifyMonitoredItemsRequest(), ua.SetPublishingModeRequest(), ua.RepublishRequest(),
        ua.TransferSubscriptionsRequest(), ua.HistoryReadRequest(), ua.DeleteNodesRequest(),
        ua.RegisterNodesRequest(), ua.CloseSessionRequest(), ua.OpenSecureChannelRequest(),
    ]  # fmt: skip


def packets(count: int, seed: int) -> Iterator[Packet]:
    """Yield `count` packets; the same seed yields the same ones."""
    rng = random.Random(seed)  # noqa: S311 - repeatable, not secret
    valid = captures()
    for number in range(count):
        data = bytearray(rng.choice(valid))
        keeps_head = rng.random() < 0.8
        for _ in range(rng.choice((1, 1, 2, 4))):
            rng.choice(_MUTATIONS)(rng, data, _HEAD if keeps_head else 0, valid)
        keeps_head = keeps_head and data[:3] == b"MSG" and len(data) >= _HEAD
        yield Packet(STAGES[number % len(STAGES)], bytes(data) or b"\0", keeps_head)


def _place(rng: random.Random, data: bytearray, start: int, width: int = 1) -> int:
    last = len(data) - width
    return rng.randint(min(start, max(last, 0)), max(last, 0))


def _flip(rng: random.Random, data: bytearray, start: int, _: list[bytes]) -> None:
    if data:
        data[_place(rng, data, start)] ^= 1 << rng.randrange(8)


def _overwrite(rng: random.Random, data: bytearray, start: int, _: list[bytes]) -> None:
    if data:
        data[_place(rng, data, start)] = rng.choice(_BYTES)


def _length(rng: random.Random, data: bytearray, start: int, _: list[bytes]) -> None:
    place = _place(rng, data, start, 4)
    data[place : place + 4] = struct.pack("<i", rng.choice(_LENGTHS))


def _cut(rng: random.Random, data: bytearray, start: int, _: list[bytes]) -> None:
    del data[_place(rng, data, start) :]
    if rng.random() < 0.7:
        _fix_size(data)


def _insert(rng: random.Random, data: bytearray, start: int, _: list[bytes]) -> None:
    place = _place(rng, data, start)
    data[place:place] = rng.randbytes(rng.choice((1, 4, 64, 2000)))
    _fix_size(data)


def _splice(
    rng: random.Random, data: bytearray, start: int, valid: list[bytes]
) -> None:
    other = rng.choice(valid)
    data[_place(rng, data, start) :] = other[rng.randrange(len(other)) :]
    _fix_size(data)


def _repeat(rng: random.Random, data: bytearray, start: int, _: list[bytes]) -> None:
    begin = _place(rng, data, start)
    part = bytes(data[begin : begin + rng.choice((1, 4, 16, 64))])
    data[begin:begin] = part * rng.choice((2, 16, 200))
    _fix_size(data)


def _header(rng: random.Random, data: bytearray, _: int, __: list[bytes]) -> None:
    kind = rng.choice((b"HEL", b"OPN", b"MSG", b"CLO", b"ERR", b"ACK", b"RHE", b"GET"))
    data[:4] = kind + rng.choice((b"F", b"C", b"A", b"X"))


def _size(rng: random.Random, data: bytearray, _: int, __: list[bytes]) -> None:
    size = rng.choice(
        (0, 7, 8, 9, 12, 24, len(data) - 1, len(data) + 1, 65_536, 2**31 - 1)
    )
    data[4:8] = struct.pack("<I", max(size, 0))


def _noise(rng: random.Random, data: bytearray, start: int, _: list[bytes]) -> None:
    data[start:] = rng.randbytes(rng.randint(0, 300))
    if start:
        _fix_size(data)


def _fix_size(data: bytearray) -> None:
    if len(data) >= 8:
        data[4:8] = struct.pack("<I", len(data))


Mutation = Callable[[random.Random, bytearray, int, list[bytes]], None]
_MUTATIONS: tuple[Mutation, ...] = (
    _flip, _flip, _overwrite, _overwrite, _length, _length, _cut, _insert, _splice, _repeat,
    _header, _size, _noise,
)  # fmt: skip
