"""Browse in pages: a long answer ends in a continuation point that BrowseNext goes on from."""

import secrets
from collections import OrderedDict
from typing import Any

from asyncua import ua

MAX_REFERENCES = 1000
MAX_POINTS = 20
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
        return [self._first_page(node, size) for node in params.NodesToBrowse]

    def browse_next(self, params: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        """Answer BrowseNext: the next page of each point, or nothing more if it is released."""
        results = []
        for point in params.ContinuationPoints:
            rest = self._points.pop(bytes(point or b""), None)
            if rest is None:
                results.append(_refused(_Codes.BadContinuationPointInvalid))
            elif params.ReleaseContinuationPoints:
                results.append(ua.BrowseResult())
            else:
                results.append(self._page(ua.BrowseResult(), *rest))
        return results

    def _first_page(self, node: ua.BrowseDescription, size: int) -> ua.BrowseResult:
        if node.NodeId not in self._address_space:
            return _refused(_Codes.BadNodeIdUnknown)
        kind = node.ReferenceTypeId
        if kind is not None and not kind.is_null() and kind not in self._address_space:
            return _refused(_Codes.BadReferenceTypeIdInvalid)
        result = self._view_service._browse(node)
        return self._page(result, result.References, size)

    def _page(self, result: ua.BrowseResult, references: list[Any], size: int) -> ua.BrowseResult:
        result.References = references[:size]
        if len(references) > size:
            if len(self._points) >= MAX_POINTS:
                return _refused(_Codes.BadNoContinuationPoints)
            result.ContinuationPoint = secrets.token_bytes(16)
            self._points[result.ContinuationPoint] = (references[size:], size)
        return result


def _refused(code: int) -> ua.BrowseResult:
    return ua.BrowseResult(StatusCode=ua.StatusCode(code))
