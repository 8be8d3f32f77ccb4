"""The views: Browse in pages and TranslateBrowsePaths, in portions.

A long answer ends in a continuation point, from which BrowseNext continues.
"""

import secrets
from collections import OrderedDict
from collections.abc import Iterable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua.rotation import Portions

_HAS_SUBTYPE = ua.NodeId(ua.ObjectIds.HasSubtype)


class TypeTree:
    """Subtypes of the types of an address space; nodes may be added, but types do not change.

    asyncua would walk the tree again for every reference of a Browse.
    """

    def __init__(self, address_space: Any) -> None:
        self._address_space = address_space
        self._closures: dict[ua.NodeId, frozenset[ua.NodeId]] = {}
        self._size = 0

    def closure(self, type_id: ua.NodeId) -> frozenset[ua.NodeId]:
        """Return a type and all its subtypes."""
        size = len(self._address_space._nodes)
        if size != self._size:
            self._closures.clear()
            self._size = size
        if type_id in self._closures:
            return self._closures[type_id]
        reached = {type_id}
        rest = [type_id]
        while rest:
            node = self._address_space.get(rest.pop())
            for reference in node.references if node is not None else ():
                if (
                    reference.IsForward
                    and reference.ReferenceTypeId == _HAS_SUBTYPE
                    and reference.NodeId not in reached
                ):
                    reached.add(reference.NodeId)
                    rest.append(reference.NodeId)
        found = frozenset(reached)
        if type_id in self._address_space:  # or unknown ids would fill the memory
            self._closures[type_id] = found
        return found


MAX_REFERENCES = 1000
MAX_REFERENCES_IN_ALL = 2000  # of one response
MAX_POINTS = 20
MAX_PATH_ELEMENTS = 50
MAX_TARGETS = 1000
_GIVE_WAY_EVERY = 50
_Mask = ua.BrowseResultMask
_FIELDS = (
    _Mask.ReferenceTypeId, _Mask.IsForward, _Mask.NodeClass, _Mask.BrowseName,
    _Mask.DisplayName, _Mask.TypeDefinition,
)  # fmt: skip
_TO_THE_END = ua.Index(2**32 - 1)
_DIRECTIONS = (
    ua.BrowseDirection.Forward,
    ua.BrowseDirection.Inverse,
    ua.BrowseDirection.Both,
)
_Codes = ua.StatusCodes
Types = frozenset[ua.NodeId] | None  # types of references that are followed; None: all


class ContinuationPoints:
    """The continuation points of one session."""

    def __init__(self, address_space: Any, types: TypeTree) -> None:
        self._address_space = address_space
        self._types = types
        self._points: OrderedDict[bytes, tuple[list[Any], int]] = OrderedDict()

    def next_page(self, point: Any, room: int, is_release: bool) -> ua.BrowseResult:
        """Return the next page of a point, or nothing more if it is released."""
        rest = self._points.pop(bytes(point or b""), None)
        if rest is None:
            raise ServiceError(_Codes.BadContinuationPointInvalid)
        return ua.BrowseResult() if is_release else self._page(*rest, room)

    def first_page(self, asked: ua.BrowseDescription, most: int, room: int) -> Portions:
        """Return the first page of the references of a node.

        Parameters
        ----------
        most : int
            Largest number of references per page for the client, 0: any.
        room : int
            References that the response still has room for.
        """
        node = self._address_space.get(asked.NodeId)
        if node is None:
            raise ServiceError(_Codes.BadNodeIdUnknown)
        if asked.BrowseDirection not in _DIRECTIONS:
            raise ServiceError(_Codes.BadBrowseDirectionInvalid)
        kind = asked.ReferenceTypeId
        types: Types = None
        if kind is not None and not kind.is_null():
            if not self._is_reference_type(kind):
                raise ServiceError(_Codes.BadReferenceTypeIdInvalid)
            types = (
                self._types.closure(kind)
                if asked.IncludeSubtypes
                else frozenset((kind,))
            )
        found = []
        for number, reference in enumerate(node.references):
            if number % _GIVE_WAY_EVERY == _GIVE_WAY_EVERY - 1:
                yield
            direction = asked.BrowseDirection
            is_in_direction = (
                direction == ua.BrowseDirection.Both
                or reference.IsForward != bool(direction)
            )
            is_wanted = (
                (is_in_direction)
                and (
                    not asked.NodeClassMask
                    or bool(asked.NodeClassMask & reference.NodeClass)
                )
                and (types is None or reference.ReferenceTypeId in types)
            )
            if is_wanted:
                found.append(_masked(reference, asked.ResultMask))
        return self._page(found, min(most or MAX_REFERENCES, MAX_REFERENCES), room)

    def _is_reference_type(self, node_id: Any) -> bool:
        node = self._address_space.get(node_id)
        if node is None:
            return False
        node_class = node.attributes[ua.AttributeIds.NodeClass].value.Value.Value
        return bool(node_class == ua.NodeClass.ReferenceType)

    def _page(self, references: list[Any], size: int, room: int) -> ua.BrowseResult:
        result = ua.BrowseResult()
        now = min(size, room)
        if len(references) > now:
            if len(self._points) >= MAX_POINTS:
                raise ServiceError(_Codes.BadNoContinuationPoints)
            result.ContinuationPoint = secrets.token_bytes(16)
            self._points[result.ContinuationPoint] = (references[now:], size)
        result.References = references[:now]
        return result


def translate(address_space: Any, types: TypeTree, path: ua.BrowsePath) -> Portions:
    """Return the targets of a browse path; a node that is reached twice is followed once."""
    elements = path.RelativePath.Elements or []
    if path.StartingNode not in address_space:
        raise ServiceError(_Codes.BadNodeIdUnknown)
    if not elements:
        raise ServiceError(_Codes.BadNothingToDo)
    if len(elements) > MAX_PATH_ELEMENTS:
        raise ServiceError(_Codes.BadTooManyMatches)
    if not elements[-1].TargetName:
        raise ServiceError(_Codes.BadBrowseNameInvalid)
    current: Iterable[ua.NodeId] = (path.StartingNode,)
    for element in elements:
        found: dict[ua.NodeId, None] = {}
        for node_id in current:
            node = address_space.get(node_id)
            kind = element.ReferenceTypeId
            wanted: Types = None
            if not kind.is_null():
                wanted = (
                    types.closure(kind)
                    if element.IncludeSubtypes
                    else frozenset((kind,))
                )
            for number, reference in enumerate(
                node.references if node is not None else ()
            ):
                if number % _GIVE_WAY_EVERY == 0:
                    yield
                if (
                    reference.IsForward != element.IsInverse
                    and reference.BrowseName == element.TargetName
                    and (wanted is None or reference.ReferenceTypeId in wanted)
                ):
                    found[reference.NodeId] = None
        current = found
        if not found or len(found) > MAX_TARGETS:
            raise ServiceError(_Codes.BadTooManyMatches if found else _Codes.BadNoMatch)
    targets = [ua.BrowsePathTarget(node_id, _TO_THE_END) for node_id in current]
    return ua.BrowsePathResult(Targets=targets)


def _masked(reference: ua.ReferenceDescription, mask: int) -> ua.ReferenceDescription:
    """Return a reference with the requested fields (OPC 10000-4, 5.9.2)."""
    if mask & _Mask.All == _Mask.All:
        return reference
    kept = ua.ReferenceDescription(NodeId=reference.NodeId, IsForward=False)
    for field in _FIELDS:
        if mask & field:
            setattr(kept, field.name, getattr(reference, field.name))
    return kept
