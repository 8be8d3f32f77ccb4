"""The address space as a NodeSet2 file (OPC 10000-6, annex F), for tools that read one.

The robot stands below Objects, not below DI's DeviceSet as in the running server, so that the file
loads into tools that do not have the DI model.
"""

import xml.etree.ElementTree as ET
from collections.abc import Iterable, Sequence

from hilserver import __version__
from hilserver.io.opcua_server import model
from hilserver.io.opcua_server.method_table import METHODS, Method
from hilserver.io.opcua_server.units import NAMESPACE_URI as UNITS_URI
from hilserver.io.opcua_server.units import Unit
from hilserver.parameters import Parameter
from hilserver.signals import SignalTable

_NS = "http://opcfoundation.org/UA/2011/03/UANodeSet.xsd"
_TYPES = "http://opcfoundation.org/UA/2008/02/Types.xsd"
_PUBLICATION_DATE = "2025-01-01T00:00:00Z"

_ORGANIZES, _HAS_TYPE, _HAS_PROPERTY, _HAS_COMPONENT = "i=35", "i=40", "i=46", "i=47"
_FOLDER_TYPE, _OBJECT_TYPE, _PROPERTY_TYPE = "i=61", "i=58", "i=68"
_RANGE, _EU_INFORMATION, _LOCALIZED_TEXT, _ARGUMENT = "i=884", "i=887", "i=21", "i=296"
_RANGE_XML, _EU_INFORMATION_XML, _ARGUMENT_XML = "i=885", "i=888", "i=297"
_READ, _READ_WRITE = "1", "3"


def to_nodeset(table: SignalTable, parameters: Iterable[Parameter] = ()) -> str:
    """Return the address space of `table` and `parameters` as the text of a NodeSet2 file."""
    root = ET.Element("UANodeSet", {"xmlns": _NS, "xmlns:uax": _TYPES})
    _child(_child(root, "NamespaceUris"), "Uri", model.NAMESPACE_URI)
    models = _child(root, "Models")
    ours = {"Version": __version__, "PublicationDate": _PUBLICATION_DATE}
    own_model = _child(models, "Model", ModelUri=model.NAMESPACE_URI, **ours)
    base = {"Version": "1.05.02", "PublicationDate": "2022-11-01T00:00:00Z"}
    _child(own_model, "RequiredModel", ModelUri="http://opcfoundation.org/UA/", **base)

    folders, variables = model.describe(table, parameters)
    robot = _node(root, "UAObject", model.ROBOT, "Robot", "The simulated robot")
    _references(robot, (_HAS_TYPE, _OBJECT_TYPE, True), (_ORGANIZES, "i=85", False))
    for folder in folders:
        element = _node(root, "UAObject", folder.path, folder.name, folder.description)
        _references(
            element, (_HAS_TYPE, _FOLDER_TYPE, True), (_ORGANIZES, _id(folder.parent), False)
        )
    for variable in variables:
        _variable(root, variable)
    for method in METHODS:
        _method(root, method)
    ET.indent(root)
    return ET.tostring(root, encoding="unicode", xml_declaration=True) + "\n"


def _id(path: str) -> str:
    return f"ns=1;s={path}"


def _child(parent: ET.Element, tag: str, text: str | None = None, **attributes: str) -> ET.Element:
    element = ET.SubElement(parent, tag, attributes)
    element.text = text
    return element


def _node(
    root: ET.Element,
    tag: str,
    path: str,
    name: str,
    description: str,
    more: dict[str, str] | None = None,
    *,
    index: int = 1,
) -> ET.Element:
    browse_name = f"{index}:{name}" if index else name
    element = _child(root, tag, NodeId=_id(path), BrowseName=browse_name, **(more or {}))
    _child(element, "DisplayName", name)
    if description:
        _child(element, "Description", description)
    return element


def _references(element: ET.Element, *rows: tuple[str, str, bool]) -> None:
    references = _child(element, "References")
    for reference_type, target, is_forward in rows:
        attributes = {"ReferenceType": reference_type}
        if not is_forward:
            attributes["IsForward"] = "false"
        _child(references, "Reference", target, **attributes)


def _variable(root: ET.Element, variable: model.Variable) -> None:
    access = _READ_WRITE if variable.writable else _READ
    more = {
        "DataType": f"i={variable.data_type}",
        "AccessLevel": access,
        "UserAccessLevel": access,
        "ParentNodeId": _id(variable.parent),
    }
    if variable.length is not None:
        more |= {"ValueRank": "1", "ArrayDimensions": str(variable.length)}
    element = _node(root, "UAVariable", variable.path, variable.name, variable.description, more)
    _references(
        element,
        (_HAS_TYPE, f"i={variable.type_definition}", True),
        (_HAS_COMPONENT, _id(variable.parent), False),
    )
    if variable.eu_range is not None:
        body = _property(root, variable.path, "EURange", _RANGE)
        _range(body, *variable.eu_range)
    if variable.unit is not None:
        _unit(_property(root, variable.path, "EngineeringUnits", _EU_INFORMATION), variable.unit)
    if variable.enum_strings:
        value = _property(root, variable.path, "EnumStrings", _LOCALIZED_TEXT, is_array=True)
        _texts(value, variable.enum_strings)
    if variable.two_states:
        for name, text in zip(("FalseState", "TrueState"), variable.two_states, strict=True):
            value = _property(root, variable.path, name, _LOCALIZED_TEXT)
            _child(_child(value, "uax:LocalizedText"), "uax:Text", text)


def _property(
    root: ET.Element, owner: str, name: str, data_type: str, *, is_array: bool = False
) -> ET.Element:
    """Add a property and return its Value element."""
    more = {"DataType": data_type, "ParentNodeId": _id(owner)}
    if is_array:
        more["ValueRank"] = "1"
    element = _node(root, "UAVariable", f"{owner}.{name}", name, "", more, index=0)
    _references(element, (_HAS_TYPE, _PROPERTY_TYPE, True), (_HAS_PROPERTY, _id(owner), False))
    return _child(element, "Value")


def _body(parent: ET.Element, type_id: str, tag: str) -> ET.Element:
    extension = _child(parent, "uax:ExtensionObject")
    _child(_child(extension, "uax:TypeId"), "uax:Identifier", type_id)
    return _child(_child(extension, "uax:Body"), f"uax:{tag}")


def _range(value: ET.Element, low: float, high: float) -> None:
    body = _body(value, _RANGE_XML, "Range")
    _child(body, "uax:Low", repr(float(low)))
    _child(body, "uax:High", repr(float(high)))


def _unit(value: ET.Element, unit: Unit) -> None:
    body = _body(value, _EU_INFORMATION_XML, "EUInformation")
    _child(body, "uax:NamespaceUri", UNITS_URI if unit.code else model.NAMESPACE_URI)
    _child(body, "uax:UnitId", str(unit.unit_id))
    _child(_child(body, "uax:DisplayName"), "uax:Text", unit.symbol)
    _child(_child(body, "uax:Description"), "uax:Text", unit.description)


def _texts(value: ET.Element, texts: Sequence[str]) -> None:
    items = _child(value, "uax:ListOfLocalizedText")
    for text in texts:
        _child(_child(items, "uax:LocalizedText"), "uax:Text", text)


def _method(root: ET.Element, method: Method) -> None:
    element = _node(root, "UAMethod", method.node_id, method.name, method.description)
    _references(element, (_HAS_COMPONENT, _id("methods"), False))
    if not method.arguments:
        return
    value = _property(root, method.node_id, "InputArguments", _ARGUMENT, is_array=True)
    items = _child(value, "uax:ListOfExtensionObject")
    for argument in method.arguments:
        body = _body(items, _ARGUMENT_XML, "Argument")
        _child(body, "uax:Name", argument.name)
        type_id = f"i={model.DATA_TYPES[argument.type]}"
        _child(_child(body, "uax:DataType"), "uax:Identifier", type_id)
        _child(body, "uax:ValueRank", "-1")
        _child(_child(body, "uax:Description"), "uax:Text", argument.description)
