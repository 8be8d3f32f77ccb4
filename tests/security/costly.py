"""Requests that a server admits, as large as its limits allow, for every service; from one seed."""

import random
import struct
from collections.abc import Iterator
from typing import Any

from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary

MOST_OPERATIONS, MOST_BYTES = 1000, 262_144
_SESSION_BYTES = 256
_References = ua.NodeId(ua.ObjectIds.References)
_Hierarchical = ua.NodeId(ua.ObjectIds.HierarchicalReferences)
_Attributes, _Type = ua.AttributeIds, ua.VariantType


def _node(rng: random.Random, nodes: list[ua.NodeId]) -> ua.NodeId:
    favourites = (
        _References, ua.NodeId(ua.ObjectIds.Structure), ua.NodeId(ua.ObjectIds.PropertyType),
        ua.NodeId(ua.ObjectIds.OpcUa_BinarySchema), ua.NodeId(ua.ObjectIds.Server),
        ua.NodeId("robot", 2), ua.NodeId("wheels.speeds_rpm", 2), ua.NodeId("pose.x_m", 2),
        ua.NodeId(ua.ObjectIds.OpcUa_XmlSchema), ua.NodeId(ua.ObjectIds.BaseDataVariableType),
    )  # fmt: skip
    return rng.choice(favourites) if rng.random() < 0.6 else rng.choice(nodes)


def _variant(rng: random.Random) -> ua.Variant:
    size = rng.choice((1, 10, 100, 1000, 100_000))
    few = min(size, 1000)
    return rng.choice(
        (
            lambda: ua.Variant(1.0, _Type.Double),
            lambda: ua.Variant([1.0] * min(size, 20_000), _Type.Double, is_array=True),
            lambda: ua.Variant([True] * size, _Type.Boolean, is_array=True),
            lambda: ua.Variant(["x"] * few, _Type.String, is_array=True),
            lambda: ua.Variant("y" * size, _Type.String),
            lambda: ua.Variant([ua.Variant()] * few, _Type.Variant, is_array=True),
            lambda: ua.Variant(
                [ua.LocalizedText("z")] * few, _Type.LocalizedText, is_array=True
            ),
            lambda: ua.Variant([ua.DataValue()] * few, _Type.DataValue, is_array=True),
            lambda: ua.Variant([ua.NodeId()] * few, _Type.NodeId, is_array=True),
        )
    )()


def _event_filter(rng: random.Random) -> ua.EventFilter:
    names = ("Message", "EventType", "Severity", "Kind", "SourceName", "nothing")

    def clause() -> ua.SimpleAttributeOperand:
        return ua.SimpleAttributeOperand(
            TypeDefinitionId=ua.NodeId(ua.ObjectIds.BaseEventType),
            BrowsePath=[ua.QualifiedName(rng.choice(names))],
            AttributeId=_Attributes.Value,
        )

    size = rng.choice((1, 10, 99))
    elements = []
    for index in range(size):
        element = ua.ContentFilterElement()
        element.FilterOperator = rng.choice(
            (ua.FilterOperator.Or, ua.FilterOperator.And)
        )
        ahead = ua.ElementOperand(min(index + 1, size - 1))
        other = ua.LiteralOperand(ua.Variant(rng.random() < 0.5))
        element.FilterOperands = [ahead, ahead if rng.random() < 0.3 else other]
        elements.append(element)
    last = elements[-1]
    last.FilterOperator = rng.choice(
        (ua.FilterOperator.InList, ua.FilterOperator.OfType)
    )
    last.FilterOperands = [clause()] + [ua.LiteralOperand(ua.Variant(7))] * rng.choice(
        (1, 300)
    )
    selected = [clause() for _ in range(rng.choice((1, 20, 499)))]
    return ua.EventFilter(
        SelectClauses=selected, WhereClause=ua.ContentFilter(elements)
    )


def _monitored(rng: random.Random, nodes: list[ua.NodeId]) -> ua.MonitoringParameters:
    asked = ua.MonitoringParameters(
        ClientHandle=rng.randrange(1000), SamplingInterval=rng.choice((0.0, 5.0, -1.0, 1e9)),
        QueueSize=rng.choice((0, 1, 10, 1000)), DiscardOldest=True,
    )  # fmt: skip
    if rng.random() < 0.3:
        asked.Filter = ua.DataChangeFilter(ua.DataChangeTrigger.StatusValue, 1, 0.5)
    return asked


class Requests:
    """Draws requests; learns what the server has given it."""

    def __init__(self, seed: int, nodes: list[ua.NodeId]) -> None:
        self.rng, self.nodes = random.Random(seed), nodes
        self.subscriptions: list[int] = [1]
        self.points: list[bytes] = [b"none"]
        self.services = sorted(name for name in dir(self) if name.startswith("do_"))

    def draw(self, service: str | None = None) -> tuple[str, Any]:
        """Return the name of a service and a request that fits into a message."""
        name = service or self.rng.choice(self.services)
        size = self.rng.choice((1, 30, MOST_OPERATIONS, MOST_OPERATIONS))
        while True:
            request = getattr(self, name)(size)
            if len(struct_to_binary(request)) < MOST_BYTES - _SESSION_BYTES:
                return name[3:], request
            size = max(1, size // 2)

    def _some(self, size: int, make: Any) -> list[Any]:
        """A few different ones, again and again: making them should be quick."""
        few = [make() for _ in range(min(size, 5))]
        return [few[i % len(few)] for i in range(size)]

    def _subscription(self) -> int:
        return self.rng.choice(self.subscriptions[-20:])

    def do_read(self, size: int) -> Any:
        request = ua.ReadRequest()
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        request.Parameters.NodesToRead = self._some(size, lambda: ua.ReadValueId(
            NodeId=_node(self.rng, self.nodes),
            AttributeId=self.rng.choice((_Attributes.Value, _Attributes.Value, *_Attributes)),
            IndexRange=self.rng.choice((None, None, "0:9", "0:4294967295")),
        ))  # fmt: skip
        return request

    def do_write(self, size: int) -> Any:
        request = ua.WriteRequest()
        names = (
            "wheel.fl.setpoint_rpm",
            "control.mode",
            "control.source",
            "pose.x_m",
            "drive.enable",
        )
        request.Parameters.NodesToWrite = self._some(size, lambda: ua.WriteValue(
            NodeId=ua.NodeId(self.rng.choice(names), 2), AttributeId=_Attributes.Value,
            Value=ua.DataValue(_variant(self.rng)),
        ))  # fmt: skip
        return request

    def do_call(self, size: int) -> Any:
        request = ua.CallRequest()
        names = (
            "Step", "Reset", "Force", "InjectFault", "SaveSnapshot", "LoadSnapshot", "SetPose",
            "Pause",
            "Start", "ClearFaults", "ResetStatistics", "Unforce", "SetSpeed",
        )  # fmt: skip
        own = ua.CallMethodRequest(
            ua.NodeId(ua.ObjectIds.Server), ua.NodeId(ua.ObjectIds.Server_GetMonitoredItems),
            [ua.Variant(self._subscription(), _Type.UInt32)],
        )  # fmt: skip
        json = "[" * 500 + "1" * self.rng.choice((1, 10_000))
        arguments = self.rng.choice((
            [], [ua.Variant("snap", _Type.String)], [ua.Variant(3, _Type.UInt32)],
            [ua.Variant(json, _Type.String)], [_variant(self.rng) for _ in range(3)],
            [ua.Variant(1.0, _Type.Double)] * 3,
            [ua.Variant("pose.x_m", _Type.String), ua.Variant(1.0, _Type.Double)],
        ))  # fmt: skip

        def call() -> ua.CallMethodRequest:
            method = ua.NodeId(f"methods.{self.rng.choice(names)}", 2)
            foreign = ua.CallMethodRequest(ua.NodeId("methods", 2), method, arguments)
            return own if self.rng.random() < 0.2 else foreign

        request.Parameters.MethodsToCall = self._some(size, call)
        request.RequestHeader.ReturnDiagnostics = self.rng.choice((0, 0xFF))
        return request

    def do_browse(self, size: int) -> Any:
        request = ua.BrowseRequest()
        request.Parameters.RequestedMaxReferencesPerNode = self.rng.choice(
            (0, 0, 1, 100)
        )
        request.Parameters.NodesToBrowse = self._some(size, lambda: ua.BrowseDescription(
            NodeId=_node(self.rng, self.nodes),
            BrowseDirection=self.rng.choice(list(ua.BrowseDirection)[:3]),
            ReferenceTypeId=self.rng.choice((ua.NodeId(), _References, _Hierarchical)),
            IncludeSubtypes=True, NodeClassMask=0, ResultMask=63,
        ))  # fmt: skip
        return request

    def do_browse_next(self, size: int) -> Any:
        request = ua.BrowseNextRequest()
        request.Parameters.ReleaseContinuationPoints = self.rng.random() < 0.5
        request.Parameters.ContinuationPoints = (self.points[-20:] * size)[:size]
        return request

    def do_translate(self, size: int) -> Any:
        request = ua.TranslateBrowsePathsToNodeIdsRequest()
        longest = self.rng.choice((1, 6, 50))

        def element() -> ua.RelativePathElement:
            names = (
                "Objects",
                "Server",
                "Types",
                "HasSubtype",
                "InputArguments",
                "PropertyType",
                "",
            )
            return ua.RelativePathElement(
                ReferenceTypeId=self.rng.choice((ua.NodeId(), _References)),
                IsInverse=self.rng.random() < 0.5, IncludeSubtypes=True,
                TargetName=ua.QualifiedName(self.rng.choice(names)),
            )  # fmt: skip

        def path() -> ua.BrowsePath:
            there = ua.RelativePathElement(
                ReferenceTypeId=_References, IncludeSubtypes=True,
                TargetName=ua.QualifiedName("PropertyType"),
            )  # fmt: skip
            back = ua.RelativePathElement(
                ReferenceTypeId=_References, IsInverse=True, IncludeSubtypes=True,
                TargetName=ua.QualifiedName("InputArguments"),
            )  # fmt: skip
            elements = [element() for _ in range(longest)]
            if self.rng.random() < 0.5:
                elements = [back, there] * (longest // 2 or 1)
            return ua.BrowsePath(_node(self.rng, self.nodes), ua.RelativePath(elements))

        request.Parameters.BrowsePaths = self._some(size, path)
        return request

    def do_register(self, size: int) -> Any:
        request = self.rng.choice(
            (ua.RegisterNodesRequest, ua.UnregisterNodesRequest)
        )()
        nodes = [_node(self.rng, self.nodes)] * size
        if isinstance(request, ua.RegisterNodesRequest):
            request.Parameters.NodesToRegister = nodes
        else:
            request.Parameters.NodesToUnregister = nodes
        return request

    def do_create_subscription(self, size: int) -> Any:
        request = ua.CreateSubscriptionRequest()
        asked = request.Parameters
        asked.RequestedPublishingInterval = self.rng.choice((0.0, 20.0, 1e9))
        asked.RequestedLifetimeCount, asked.RequestedMaxKeepAliveCount = 3000, 1
        asked.PublishingEnabled = True
        return request

    def do_modify_subscription(self, size: int) -> Any:
        request = ua.ModifySubscriptionRequest()
        request.Parameters.SubscriptionId = self._subscription()
        request.Parameters.RequestedPublishingInterval = self.rng.choice(
            (0.0, 5.0, 1000.0)
        )
        return request

    def do_subscription_lists(self, size: int) -> Any:
        kind = self.rng.choice(
            ("DeleteSubscriptions", "SetPublishingMode", "TransferSubscriptions")
        )
        request = getattr(ua, f"{kind}Request")()
        share = 20 if kind == "DeleteSubscriptions" else len(self.subscriptions)
        request.Parameters.SubscriptionIds = (self.subscriptions[:share] * size)[:size]
        return request

    def do_create_items(self, size: int) -> Any:
        request = ua.CreateMonitoredItemsRequest()
        request.Parameters.SubscriptionId = self._subscription()
        request.Parameters.TimestampsToReturn = ua.TimestampsToReturn.Both
        is_event = self.rng.random() < 0.5

        def item() -> ua.MonitoredItemCreateRequest:
            made = ua.MonitoredItemCreateRequest(
                MonitoringMode=self.rng.choice(list(ua.MonitoringMode)),
                RequestedParameters=_monitored(self.rng, self.nodes),
            )
            made.ItemToMonitor = ua.ReadValueId(
                _node(self.rng, self.nodes), _Attributes.Value
            )
            if is_event:
                made.ItemToMonitor = ua.ReadValueId(
                    ua.NodeId(ua.ObjectIds.Server), _Attributes.EventNotifier
                )
                made.RequestedParameters.Filter = _event_filter(self.rng)
            return made

        request.Parameters.ItemsToCreate = self._some(size, item)
        return request

    def do_modify_items(self, size: int) -> Any:
        request = ua.ModifyMonitoredItemsRequest()
        request.Parameters.SubscriptionId = self._subscription()
        request.Parameters.ItemsToModify = self._some(size, lambda: ua.MonitoredItemModifyRequest(
            self.rng.randrange(1, 2000), _monitored(self.rng, self.nodes)
        ))  # fmt: skip
        return request

    def do_item_lists(self, size: int) -> Any:
        kind = self.rng.choice(
            ("DeleteMonitoredItems", "SetMonitoringMode", "SetMonitoringMode")
        )
        request = getattr(ua, f"{kind}Request")()
        request.Parameters.SubscriptionId = self._subscription()
        request.Parameters.MonitoredItemIds = [
            self.rng.randrange(1, 2000) for _ in range(size)
        ]
        if kind == "SetMonitoringMode":
            request.Parameters.MonitoringMode = self.rng.choice(list(ua.MonitoringMode))
        return request

    def do_triggering(self, size: int) -> Any:
        request = ua.SetTriggeringRequest()
        request.Parameters.SubscriptionId = self._subscription()
        request.Parameters.TriggeringItemId = self.rng.randrange(1, 2000)
        ids = [self.rng.randrange(1, 2000) for _ in range(size)]
        request.Parameters.LinksToAdd, request.Parameters.LinksToRemove = (
            ids[: size // 2],
            ids[size // 2 :],
        )
        return request

    def do_publish(self, size: int) -> Any:
        request = ua.PublishRequest()
        request.Parameters.SubscriptionAcknowledgements = [
            ua.SubscriptionAcknowledgement(self._subscription(), number)
            for number in range(size)
        ]
        return request

    def do_republish(self, size: int) -> Any:
        request = ua.RepublishRequest()
        request.Parameters.SubscriptionId = self._subscription()
        request.Parameters.RetransmitSequenceNumber = self.rng.randrange(1, 10)
        return request

    def do_discover(self, size: int) -> Any:
        if self.rng.random() < 0.5:
            found = ua.FindServersRequest()
            found.Parameters.ServerUris = ["urn:x"] * size
            found.Parameters.LocaleIds = ["en"] * size
            return found
        asked = ua.GetEndpointsRequest()
        asked.Parameters.ProfileUris = ["http://x"] * size
        return asked

    def do_session(self, size: int) -> Any:
        request = ua.ActivateSessionRequest()
        request.Parameters.LocaleIds = ["en"] * size
        token = ua.UserNameIdentityToken(
            PolicyId="username", UserName="u" * size, Password=b"p" * size
        )
        anonymous = ua.AnonymousIdentityToken(PolicyId="anonymous")
        request.Parameters.UserIdentityToken = self.rng.choice((token, anonymous))
        return request


def bytes_of(wire: Any, request: Any) -> bytes:
    """Return a request as it is sent in the session of `wire`."""
    request.RequestHeader.AuthenticationToken = wire.authentication
    return bytes(struct_to_binary(request))


def chunks(wire: Any, request: Any) -> Iterator[bytes]:
    """Yield the chunks of a request (or bytes), however long it is."""
    data = request if isinstance(request, bytes) else bytes_of(wire, request)
    size = 60_000
    request_id = wire._sequence + 1
    for first in range(0, len(data), size):
        is_last = first + size >= len(data)
        wire._sequence += 1
        head = struct.pack(
            "<IIII", wire.channel, wire.token, wire._sequence, request_id
        )
        body = head + data[first : first + size]
        yield (
            struct.pack("<3scI", b"MSG", b"F" if is_last else b"C", 8 + len(body))
            + body
        )
