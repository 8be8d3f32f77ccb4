"""Puts the rows of `model` and `method_table` into an asyncua server."""

from collections.abc import Iterable, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

from asyncua import ua

from hilserver import __version__
from hilserver.io.opcua_server import model
from hilserver.io.opcua_server.method_table import Method
from hilserver.io.opcua_server.server_status import GROUP, LOCALIZED_TEXT, Entry
from hilserver.io.opcua_server.units import NAMESPACE_URI as UNITS_URI
from hilserver.io.opcua_server.units import Unit

_READ_WRITE = ua.AccessLevel.CurrentRead.mask | ua.AccessLevel.CurrentWrite.mask
_PUBLISHED = datetime.fromtimestamp(Path(__file__).stat().st_mtime, UTC)
_WAITING = ua.StatusCode(ua.StatusCodes.BadWaitingForInitialData)
OBJECTS = ua.NodeId(ua.ObjectIds.ObjectsFolder)
SERVER = ua.NodeId(ua.ObjectIds.Server)
_CLASSES = {
    ua.ObjectAttributes: ua.NodeClass.Object,
    ua.ObjectTypeAttributes: ua.NodeClass.ObjectType,
    ua.VariableAttributes: ua.NodeClass.Variable,
    ua.MethodAttributes: ua.NodeClass.Method,
}


class NodePlace(NamedTuple):
    """Where a node is added, and by which reference."""

    node_id: ua.NodeId
    name: ua.QualifiedName
    parent: ua.NodeId
    reference: int


class AddressSpaceBuilder:
    """Adds nodes of our namespace."""

    def __init__(self, node_service: Any, robot_index: int, di_index: int) -> None:
        self._service = node_service
        self._index = robot_index
        self._di_index = di_index
        self.device_set = ua.NodeId(model.DI_DEVICE_SET, di_index)
        self.robot = self.node_id(model.ROBOT)

    def node_id(self, path: str) -> ua.NodeId:
        """Return the node id of a dotted name."""
        return ua.NodeId(path, self._index)

    def name(self, text: str) -> ua.QualifiedName:
        """Return a browse name in our namespace."""
        return ua.QualifiedName(text, self._index)

    def _place(self, path: str, name: str, parent: str, reference: int) -> NodePlace:
        """Return the place of one of our nodes below another one."""
        return NodePlace(
            self.node_id(path), self.name(name), self.node_id(parent), reference
        )

    def roots(self) -> None:
        """Add DI's DeviceSet and the robot below it."""
        kinds = ua.ObjectIds
        name = ua.QualifiedName("DeviceSet", self._di_index)
        device_set = NodePlace(self.device_set, name, OBJECTS, kinds.Organizes)
        self._object(
            device_set, kinds.BaseObjectType, "Contains all instances of devices"
        )
        robot = NodePlace(
            self.robot, self.name("Robot"), self.device_set, kinds.HasComponent
        )
        events = ua.EventNotifier.SubscribeToEvents.mask
        self._object(robot, kinds.BaseObjectType, "The simulated robot", events)
        self.reference(SERVER, self.robot, kinds.HasNotifier, ua.NodeClass.Object)

    def namespaces(self) -> None:
        """Describe both namespaces; a nodeset file does this by its models."""
        self._namespace(model.NAMESPACE_URI, self._index, __version__, ua.IdType.String)
        self._namespace(
            model.DI_NAMESPACE_URI, self._di_index, model.DI_VERSION, ua.IdType.Numeric
        )

    def nameplate(self, entries: Iterable[Entry]) -> None:
        """Add the nameplate: properties of the robot, referenced by a group as well."""
        group = self.node_id(f"{model.ROBOT}.{GROUP}")
        kinds = ua.ObjectIds
        name = ua.QualifiedName(GROUP, self._di_index)
        place = NodePlace(group, name, self.robot, kinds.HasComponent)
        self._object(place, kinds.FolderType, "Manufacturer and identity of the robot")
        for name, value, kind in entries:
            shown = ua.LocalizedText(value) if kind == LOCALIZED_TEXT else value
            typed = ua.Variant(shown, ua.VariantType(kind))
            entry = self.property(model.ROBOT, name, typed, kind, self._di_index)
            self.reference(group, entry, kinds.Organizes, ua.NodeClass.Variable)

    def _namespace(self, uri: str, index: int, version: str, ids: ua.IdType) -> None:
        """Describe one of our namespaces where clients look for it (OPC 10000-5, 6.3.13)."""
        kinds = ua.ObjectIds
        path = f"namespaces.{index}"
        parent = ua.NodeId(kinds.Server_Namespaces)
        name = ua.QualifiedName(uri, index)
        place = NodePlace(self.node_id(path), name, parent, kinds.HasComponent)
        self._object(place, kinds.NamespaceMetadataType, uri)
        no_ranges = ua.Variant([], ua.VariantType.String, is_array=True)
        id_types = (
            "StaticNodeIdTypes",
            ua.Variant([ids], ua.VariantType.Int32),
            kinds.IdType,
        )
        for entry, value, kind in (
            ("NamespaceUri", uri, kinds.String),
            ("NamespaceVersion", version, kinds.String),
            ("NamespacePublicationDate", _PUBLISHED, kinds.DateTime),
            ("IsNamespaceSubset", index == self._di_index, kinds.Boolean),
            id_types,
            ("StaticNumericNodeIdRange", no_ranges, kinds.NumericRange),
            ("StaticStringNodeIdPattern", "", kinds.String),
        ):
            self.property(path, entry, value, kind)

    def folders(self, folders: Iterable[model.Folder]) -> None:
        """Add folders; each after the one that holds it."""
        for row in folders:
            place = self._place(row.path, row.name, row.parent, ua.ObjectIds.Organizes)
            self._object(place, ua.ObjectIds.FolderType, row.description)

    def variable(self, row: model.Variable) -> None:
        """Add a variable without a value yet (BadWaitingForInitialData) and its properties."""
        attributes = ua.VariableAttributes()
        attributes.Description = ua.LocalizedText(row.description)
        attributes.DataType = ua.NodeId(row.data_type)
        attributes.ValueRank = -1 if row.length is None else 1
        attributes.ArrayDimensions = None if row.length is None else [row.length]
        if row.writable:
            attributes.AccessLevel = _READ_WRITE
        else:
            attributes.AccessLevel = ua.AccessLevel.CurrentRead.mask
        attributes.UserAccessLevel = attributes.AccessLevel
        # 0: every change is reported, there is no sampling between plant and subscriber.
        attributes.MinimumSamplingInterval = 0.0
        place = self._place(row.path, row.name, row.parent, ua.ObjectIds.HasComponent)
        self.value_of(
            self._add(place, attributes, row.type_definition)
        ).value = ua.DataValue(
            ua.Variant(), _WAITING, ServerTimestamp=datetime.now(UTC)
        )
        kinds = ua.ObjectIds
        if row.eu_range is not None:
            low, high = row.eu_range
            limits = ua.Range(float(low), float(high))
            self.property(row.path, "EURange", limits, kinds.Range)
        if row.unit is not None:
            unit = eu_information(row.unit)
            self.property(row.path, "EngineeringUnits", unit, kinds.EUInformation)
        if row.enum_strings:
            texts = [ua.LocalizedText(text) for text in row.enum_strings]
            self.property(row.path, "EnumStrings", texts, kinds.LocalizedText)
        if row.two_states:
            for name, text in zip(
                ("FalseState", "TrueState"), row.two_states, strict=True
            ):
                self.property(
                    row.path, name, ua.LocalizedText(text), kinds.LocalizedText
                )

    def property(
        self, owner: str, name: str, value: Any, data_type: int, namespace: int = 0
    ) -> ua.NodeId:
        """Add a property with a constant value; standard names are in namespace 0."""
        attributes = ua.VariableAttributes()
        attributes.DataType = ua.NodeId(data_type)
        attributes.ValueRank = 1 if isinstance(value, list) else -1
        attributes.ArrayDimensions = [0] if isinstance(value, list) else None
        attributes.Value = value if isinstance(value, ua.Variant) else ua.Variant(value)
        node_id = self.node_id(f"{owner}.{name}")
        browse_name = ua.QualifiedName(name, namespace)
        place = NodePlace(
            node_id, browse_name, self.node_id(owner), ua.ObjectIds.HasProperty
        )
        return self._add(place, attributes, ua.ObjectIds.PropertyType)

    def method(self, method: Method) -> ua.NodeId:
        """Add a method with the description of its arguments."""
        attributes = ua.MethodAttributes()
        attributes.Description = ua.LocalizedText(method.description)
        attributes.Executable = attributes.UserExecutable = True
        place = self._place(
            method.node_id, method.name, "methods", ua.ObjectIds.HasComponent
        )
        node_id = self._add(place, attributes)
        if method.arguments:
            arguments = [
                ua.Argument(
                    Name=argument.name,
                    DataType=ua.NodeId(model.DATA_TYPES[argument.type]),
                    ValueRank=-1,
                    Description=ua.LocalizedText(argument.description),
                )
                for argument in method.arguments
            ]
            self.property(
                method.node_id, "InputArguments", arguments, ua.ObjectIds.Argument
            )
        return node_id

    def event_type(
        self,
        path: str,
        name: str,
        base: ua.NodeId,
        properties: Sequence[tuple[str, int, Any]],
    ) -> ua.NodeId:
        """Add an event type; `properties` are rows of name, data type, initial value."""
        attributes = ua.ObjectTypeAttributes()
        attributes.IsAbstract = False
        kinds = ua.ObjectIds
        mandatory = ua.NodeId(ua.ObjectIds.ModellingRule_Mandatory)
        place = NodePlace(self.node_id(path), self.name(name), base, kinds.HasSubtype)
        node_id = self._add(place, attributes)
        for entry, data_type, value in properties:
            typed = ua.Variant(value, ua.VariantType(data_type))
            added = self.property(path, entry, typed, data_type, self._index)
            self._reference(
                added, mandatory, kinds.HasModellingRule, ua.NodeClass.Object
            )
        return node_id

    def value_of(self, node_id: ua.NodeId) -> Any:
        """Return the place where asyncua keeps a node's value and its subscribers."""
        return self._service._aspace[node_id].attributes[ua.AttributeIds.Value]

    def set_place(self, node_id: ua.NodeId, place: Any) -> None:
        """Replace the place where a node's value is kept."""
        self._service._aspace[node_id].attributes[ua.AttributeIds.Value] = place

    def reference(
        self,
        source: ua.NodeId,
        target: ua.NodeId,
        kind: int,
        target_class: ua.NodeClass,
    ) -> None:
        """Add a reference and its inverse."""
        self._reference(source, target, kind, target_class)
        self._reference(target, source, kind, ua.NodeClass.Object, is_forward=False)

    def _reference(
        self,
        source: ua.NodeId,
        target: ua.NodeId,
        kind: int,
        target_class: ua.NodeClass,
        *,
        is_forward: bool = True,
    ) -> None:
        item = ua.AddReferencesItem()
        item.SourceNodeId = source
        item.TargetNodeId = target
        item.ReferenceTypeId = ua.NodeId(kind)
        item.IsForward = is_forward
        item.TargetNodeClass = target_class
        self._service.add_references([item])[0].check()

    def _object(
        self, place: NodePlace, type_definition: int, about: str, notifier: int = 0
    ) -> None:
        attributes = ua.ObjectAttributes()
        attributes.Description = ua.LocalizedText(about)
        attributes.EventNotifier = notifier
        self._add(place, attributes, type_definition)

    def _add(
        self, place: NodePlace, attributes: Any, type_definition: int | None = None
    ) -> ua.NodeId:
        attributes.DisplayName = ua.LocalizedText(place.name.Name)
        item = ua.AddNodesItem()
        item.RequestedNewNodeId = place.node_id
        item.BrowseName = place.name
        item.ParentNodeId = place.parent
        item.ReferenceTypeId = ua.NodeId(place.reference)
        item.NodeClass = _CLASSES[type(attributes)]
        if type_definition is not None:
            item.TypeDefinition = ua.NodeId(type_definition)
        item.NodeAttributes = attributes
        self._service.add_nodes([item])[0].StatusCode.check()
        return place.node_id


def eu_information(unit: Unit) -> ua.EUInformation:
    """Return a unit as OPC UA's EUInformation."""
    namespace = UNITS_URI if unit.code else model.NAMESPACE_URI
    shown = ua.LocalizedText(unit.symbol)
    explained = ua.LocalizedText(unit.description)
    return ua.EUInformation(
        NamespaceUri=namespace,
        UnitId=unit.unit_id,
        DisplayName=shown,
        Description=explained,
    )
