"""Values of the standard nodes below Objects that asyncua leaves without one.

A client that reads them would wait for initial data for ever. Known values are filled in: limits,
languages. Features that the server lacks (redundancy, history, PubSub, certificates that are
managed over OPC UA) get the zero of their type: False, 0, empty.
"""

from collections.abc import Iterator
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from hilserver.opcua.browsing import MAX_POINTS
from hilserver.opcua.encoding import FixedDataValue
from hilserver.opcua.monitored_items import MAX_SELECTED
from hilserver.opcua.settings import OpcUaSettings
from hilserver.opcua.where import MAX_OPERANDS

_Ids, _Attributes, _Type = ua.ObjectIds, ua.AttributeIds, ua.VariantType
_OBJECTS = ua.NodeId(_Ids.ObjectsFolder)
_HAS_SUBTYPE, _ENUMERATION, _STRUCTURE = ua.NodeId(_Ids.HasSubtype), 29, 22
_OPERATION_LIMITS = (
    "Read", "Write", "MethodCall", "Browse", "RegisterNodes", "TranslateBrowsePathsToNodeIds",
)  # fmt: skip


def fill(address_space: Any, settings: OpcUaSettings) -> None:
    """Give every standard variable below Objects a value."""
    engineer = settings.limits.engineer
    values = {
        "LocaleIdArray": ["en"],
        "MinSupportedSampleRate": settings.min_publishing_ms,
        "MaxBrowseContinuationPoints": MAX_POINTS,
        "MaxSessions": settings.max_sessions,
        "MaxSubscriptions": settings.max_subscriptions,
        "MaxMonitoredItems": settings.max_monitored_items,
        "MaxSubscriptionsPerSession": engineer.subscriptions,
        "MaxMonitoredItemsPerSubscription": engineer.monitored_items,
        "MaxSelectClauseParameters": MAX_SELECTED,
        "MaxWhereClauseParameters": MAX_OPERANDS,
        "MaxMonitoredItemsQueueSize": settings.max_queue_size,
        "OperationLimits_MaxMonitoredItemsPerCall": settings.max_operations,
    }
    for service in _OPERATION_LIMITS:
        values[f"OperationLimits_MaxNodesPer{service}"] = settings.max_operations
    known = {
        getattr(_Ids, f"Server_ServerCapabilities_{name}"): value
        for name, value in values.items()
    }
    for node_id, node in _variables(address_space):
        place = node.attributes[_Attributes.Value]
        if node_id.Identifier in known:
            _put(place, *_type_of(address_space, node), known[node_id.Identifier])
        elif (
            place.value is None
            or place.value.Value is None
            or place.value.Value.Value is None
        ):
            _put(place, *_type_of(address_space, node), None)


def _variables(address_space: Any) -> Iterator[tuple[ua.NodeId, Any]]:
    """Yield the standard variables below Objects, which are instances, not types."""
    seen = {_OBJECTS}
    rest = [_OBJECTS]
    below = {
        _Ids.Organizes,
        _Ids.HasProperty,
        _Ids.HasComponent,
        _Ids.HasOrderedComponent,
    }
    while rest:
        node_id = rest.pop()
        node = address_space[node_id]
        if (
            node.attributes[_Attributes.NodeClass].value.Value.Value
            == ua.NodeClass.Variable
        ):
            yield node_id, node
        for reference in node.references:
            target = reference.NodeId
            if (
                reference.IsForward
                and reference.ReferenceTypeId.Identifier in below
                and target not in seen
                and target in address_space
                and target.NamespaceIndex == 0
            ):
                seen.add(target)
                rest.append(target)


def _type_of(address_space: Any, node: Any) -> tuple[ua.VariantType, Any, bool]:
    """Return the built-in type of a variable, its data type, and whether it is an array."""
    data_type = kind = node.attributes[_Attributes.DataType].value.Value.Value
    while kind.NamespaceIndex == 0 and kind.Identifier not in _BUILT_IN:
        parents = [
            r.NodeId
            for r in address_space[kind].references
            if not r.IsForward and r.ReferenceTypeId == _HAS_SUBTYPE
        ]
        if not parents:
            break
        kind = parents[0]
    rank = node.attributes[_Attributes.ValueRank].value.Value.Value
    return _BUILT_IN.get(kind.Identifier, _Type.Null), data_type, rank >= 1


_BUILT_IN = {kind.value: kind for kind in _Type if 0 < kind.value < _STRUCTURE}
_BUILT_IN |= {_STRUCTURE: _Type.ExtensionObject, _ENUMERATION: _Type.Int32}
_BUILT_IN |= {24: _Type.Variant, 26: _Type.Double, 27: _Type.Int64, 28: _Type.UInt64}
"""By number of the data type; abstract number types map to their widest one."""


def _put(
    place: Any, kind: ua.VariantType, data_type: Any, is_array: bool, value: Any
) -> None:
    if value is None:
        value = [] if is_array else _zero(kind, data_type)
    place.value = FixedDataValue.good(value, kind, is_array=is_array)


def _zero(kind: ua.VariantType, data_type: Any) -> Any:
    if kind is _Type.ExtensionObject:
        return ua.extension_objects_by_datatype.get(data_type, lambda: None)()
    if kind is _Type.DateTime:
        return datetime(1601, 1, 1, tzinfo=UTC)  # which clients show as "never"
    if kind in (_Type.String, _Type.ByteString):
        return "" if kind is _Type.String else b""
    return ua.get_default_value(kind)
