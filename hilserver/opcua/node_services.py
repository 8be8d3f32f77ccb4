"""Services on nodes: Read, Write, Call, and the views."""

from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua import encoding
from hilserver.opcua.application import refused
from hilserver.opcua.browsing import MAX_REFERENCES_IN_ALL, translate
from hilserver.opcua.portions import check_stamps, each, limited, status_codes
from hilserver.opcua.rotation import Portions
from hilserver.opcua.sessions import Session

_Codes, _Ids = ua.StatusCodes, ua.ObjectIds
_MAX_READ_BYTES = 1 << 20
"""Limit of one response to Read; the longest values of the standard exceed 100 kB."""
_SERVER = ua.NodeId(_Ids.Server)
_GET_MONITORED_ITEMS = ua.NodeId(_Ids.Server_GetMonitoredItems)


def read(session: Session, params: encoding.ReadItems) -> Portions:
    """Answer Read with encoded values; user-dependent attributes are those of this user."""
    items = limited(session, params.items)
    if not params.max_age_ms >= 0:
        raise ServiceError(_Codes.BadMaxAgeInvalid)
    stamps = check_stamps(params.stamps)
    reader = session.server.reader
    user = session.user
    values: list[bytes] = []
    size = 0
    for item in items:
        if session.is_out_of_time:
            value = reader.refused(_Codes.BadTimeout)
        else:
            value = reader.read(item, user)
        values.append(value.encoded(stamps))
        size += len(values[-1])
        if size > _MAX_READ_BYTES:
            raise ServiceError(_Codes.BadResponseTooLarge)
        yield
    return values


def write(session: Session, params: ua.WriteParameters) -> Portions:
    """Answer Write."""
    items = limited(session, params.NodesToWrite)
    answers = yield from session.server.application.write(items, session)
    session.texts = [answer.text for answer in answers]
    return ua.WriteResponse(Results=status_codes([answer.code for answer in answers]))


def call(session: Session, params: ua.CallParameters) -> Portions:
    """Answer Call; a method may wait."""
    application = session.server.application
    session.texts = texts = []

    def act(request: ua.CallMethodRequest) -> Portions:
        texts.append("")
        if application.is_method(request.MethodId):
            result, texts[-1] = yield application.call(request, session)
            return result
        if request.MethodId == _GET_MONITORED_ITEMS and request.ObjectId == _SERVER:
            arguments = request.InputArguments or []
            if len(arguments) != 1:
                raise ServiceError(
                    _Codes.BadTooManyArguments
                    if arguments
                    else _Codes.BadArgumentsMissing
                )
            if arguments[0].VariantType != ua.VariantType.UInt32:
                wrong = status_codes([_Codes.BadTypeMismatch])
                return refused(_Codes.BadInvalidArgument, results=wrong).result
            handles = session.own(arguments[0].Value).items.handles()
            kind = ua.VariantType.UInt32
            columns = [
                ua.Variant([pair[i] for pair in handles], kind, None, True)
                for i in (0, 1)
            ]
            return ua.CallMethodResult(
                StatusCode=ua.StatusCode(_Codes.Good), OutputArguments=columns
            )
        is_known = request.MethodId in session.server.aspace
        raise ServiceError(
            _Codes.BadNotImplemented if is_known else _Codes.BadMethodInvalid
        )

    return each(
        session, params.MethodsToCall, act, ua.CallResponse(), ua.CallMethodResult
    )


# --- views ----------------------------------------------------------------------------------------


def browse(session: Session, params: ua.BrowseParameters) -> Portions:
    """Answer Browse; long answers come in pages."""
    limited(session, params.NodesToBrowse)
    if not params.View.ViewId.is_null():
        raise ServiceError(_Codes.BadViewIdUnknown)
    most = params.RequestedMaxReferencesPerNode
    room = MAX_REFERENCES_IN_ALL

    def page(asked: ua.BrowseDescription) -> Portions:
        nonlocal room
        result = yield from session.pages.first_page(asked, most, room)
        room -= len(result.References)
        return result

    return each(
        session, params.NodesToBrowse, page, ua.BrowseResponse(), ua.BrowseResult
    )


def browse_next(session: Session, params: ua.BrowseNextParameters) -> Portions:
    """Answer BrowseNext."""
    room = MAX_REFERENCES_IN_ALL

    def page(point: Any) -> ua.BrowseResult:
        nonlocal room
        result = session.pages.next_page(point, room, params.ReleaseContinuationPoints)
        room -= len(result.References)
        return result

    response = ua.BrowseNextResponse()
    return each(session, params.ContinuationPoints, page, response, ua.BrowseResult)


def translate_paths(
    session: Session, params: ua.TranslateBrowsePathsToNodeIdsParameters
) -> Portions:
    """Answer TranslateBrowsePathsToNodeIds."""
    server, response = session.server, ua.TranslateBrowsePathsToNodeIdsResponse()

    def follow(path: ua.BrowsePath) -> Portions:
        return translate(server.aspace, server.types, path)

    return each(session, params.BrowsePaths, follow, response, ua.BrowsePathResult)


def register_nodes(
    session: Session, params: ua.RegisterNodesParameters
) -> ua.RegisterNodesResponse:
    """Answer RegisterNodes: node ids are as fast as handles here and are returned as they are."""
    response = ua.RegisterNodesResponse()
    response.Parameters.RegisteredNodeIds = list(
        limited(session, params.NodesToRegister)
    )
    return response


def unregister_nodes(
    session: Session, params: ua.UnregisterNodesParameters
) -> ua.UnregisterNodesResponse:
    """Answer UnregisterNodes."""
    limited(session, params.NodesToUnregister)
    return ua.UnregisterNodesResponse()
