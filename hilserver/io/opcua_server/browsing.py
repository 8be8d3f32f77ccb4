"""Browse in pages: a long answer ends in a continuation point that BrowseNext goes on from."""

import secrets
from collections import OrderedDict
from collections.abc import Callable
from typing import Any

from asyncua import ua

MAX_REFERENCES = 1000
MAX_REFERENCES_IN_ALL = 2000
"""Of one response: encoding them takes time that the other clients wait."""
MAX_POINTS = 20
_ALL_FIELDS = 63
_DIRECTIONS = (ua.BrowseDirection.Forward, ua.BrowseDirection.Inverse, ua.BrowseDirection.Both)
_Codes = ua.StatusCodes


class ContinuationPoints:
    """The continuation points of one session.

    Parameters
    ----------
    view_service, address_space : asyncua ViewService and AddressSpace
    """

    def __init__(self, view_service: Any, address_space: Any) -> None:
        self._view_service = view_service
        self._address_space = address_space
        self._points: OrderedDict[bytes, tuple[list[Any], int]] = OrderedDict()

    def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        """Answer Browse; a session that opens more points than it may gets no more of them."""
        asked = params.RequestedMaxReferencesPerNode
        size = min(asked, MAX_REFERENCES) if asked else MAX_REFERENCES
        return self._in_bounds(
            lambda node, room: self._first_page(node, size, room), params.NodesToBrowse
        )

    def browse_next(self, params: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        """Answer BrowseNext: the next page of each point, or nothing more if it is released."""
        is_release = params.ReleaseContinuationPoints
        return self._in_bounds(
            lambda point, room: self._next_page(point, is_release, room), params.ContinuationPoints
        )

    @staticmethod
    def _in_bounds(page: Callable[[Any, int], ua.BrowseResult], asked: Any) -> list[Any]:
        room = MAX_REFERENCES_IN_ALL
        results = []
        for item in asked:
            results.append(page(item, room))
            room -= len(results[-1].References or ())
        return results

    def _next_page(self, point: Any, is_release: bool, room: int) -> ua.BrowseResult:
        rest = self._points.pop(bytes(point or b""), None)
        if rest is None:
            return _refused(_Codes.BadContinuationPointInvalid)
        return ua.BrowseResult() if is_release else self._page(ua.BrowseResult(), *rest, room)

    def _first_page(self, node: ua.BrowseDescription, size: int, room: int) -> Any:
        if node.NodeId not in self._address_space:
            return _refused(_Codes.BadNodeIdUnknown)
        if node.BrowseDirection not in _DIRECTIONS:
            return _refused(_Codes.BadBrowseDirectionInvalid)
        kind = node.ReferenceTypeId
        if kind is not None and not kind.is_null() and not self._is_reference_type(kind):
            return _refused(_Codes.BadReferenceTypeIdInvalid)
        result = self._view_service._browse(node)
        references = [_masked(reference, node.ResultMask) for reference in result.References]
        return self._page(result, references, size, room)

    def _is_reference_type(self, node_id: Any) -> bool:
        node = self._address_space.get(node_id)
        if node is None:
            return False
        node_class = node.attributes[ua.AttributeIds.NodeClass].value.Value.Value
        return bool(node_class == ua.NodeClass.ReferenceType)

    def _page(
        self, result: ua.BrowseResult, references: list[Any], size: int, room: int
    ) -> ua.BrowseResult:
        now = min(size, room)
        if len(references) > now:
            if len(self._points) >= MAX_POINTS:
                return _refused(_Codes.BadNoContinuationPoints)
            result.ContinuationPoint = secrets.token_bytes(16)
            self._points[result.ContinuationPoint] = (references[now:], size)
        result.References = references[:now]
        return result


def _masked(reference: ua.ReferenceDescription, mask: int) -> ua.ReferenceDescription:
    """Return a reference with the fields that are asked for (OPC 10000-4, 5.9.2)."""
    if mask & _ALL_FIELDS == _ALL_FIELDS:
        return reference
    bits = ua.BrowseResultMask
    kept = ua.ReferenceDescription(NodeId=reference.NodeId)
    if mask & bits.ReferenceTypeId:
        kept.ReferenceTypeId = reference.ReferenceTypeId
    kept.IsForward = bool(mask & bits.IsForward and reference.IsForward)
    if mask & bits.NodeClass:
        kept.NodeClass = reference.NodeClass
    if mask & bits.BrowseName:
        kept.BrowseName = reference.BrowseName
    if mask & bits.DisplayName:
        kept.DisplayName = reference.DisplayName
    if mask & bits.TypeDefinition:
        kept.TypeDefinition = reference.TypeDefinition
    return kept


def _refused(code: int) -> ua.BrowseResult:
    return ua.BrowseResult(StatusCode=ua.StatusCode(code))
