"""Services on nodes: Read, Write, Call, and the views."""

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua import encoding
from hilserver.opcua.browsing import MAX_REFERENCES_IN_ALL, translate
from hilserver.opcua.portions import check_stamps, limited, status_codes
from hilserver.opcua.rotation import Portions
from hilserver.opcua.sessions import Session

_Codes, _Ids = ua.StatusCodes, ua.ObjectIds
_MAX_READ_BYTES = 1 << 20
"""Of one response to Read: the longest values of the standard have 100 kB and more."""
_SERVER = ua.NodeId(_Ids.Server)
_GET_MONITORED_ITEMS = ua.NodeId(_Ids.Server_GetMonitoredItems)


def read(session: Session, params: encoding.ReadItems) -> Portions:
    """Answer Read with encoded values; what depends on the user is that of this user."""
    items = limited(session, params.items)
    if not params.max_age_ms >= 0:
        raise ServiceError(_Codes.BadMaxAgeInvalid)
    stamps = check_stamps(params.stamps)
    reader, user = session.server.reader, session.user
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
    results: list[ua.CallMethodResult] = []
    texts: list[str] = []
    application = session.server.application
    for request in limited(session, params.MethodsToCall):
        text = ""
        if session.is_out_of_time:
            result = ua.CallMethodResult(StatusCode=ua.StatusCode(_Codes.BadTimeout))
        elif application.is_method(request.MethodId):
            result, text = yield application.call(request, session)
        elif request.MethodId == _GET_MONITORED_ITEMS and request.ObjectId == _SERVER:
            result = _monitored_items(session, request.InputArguments or [])
        else:
            is_known = request.MethodId in session.server.aspace
            code = _Codes.BadNotImplemented if is_known else _Codes.BadMethodInvalid
            result = ua.CallMethodResult(StatusCode=ua.StatusCode(code))
        results.append(result)
        texts.append(text)
        yield
    session.texts = texts
    return ua.CallResponse(Results=results)


def _monitored_items(session: Session, arguments: list[ua.Variant]) -> ua.CallMethodResult:
    result = ua.CallMethodResult()
    if len(arguments) != 1:
        code = _Codes.BadTooManyArguments if arguments else _Codes.BadArgumentsMissing
    elif arguments[0].VariantType != ua.VariantType.UInt32:
        code = _Codes.BadInvalidArgument
        result.InputArgumentResults = status_codes([_Codes.BadTypeMismatch])
    else:
        try:
            handles = session.own(arguments[0].Value).items.handles()
        except ServiceError as error:
            code = error.code
        else:
            code = _Codes.Good
            kind = ua.VariantType.UInt32
            result.OutputArguments = [
                ua.Variant([pair[i] for pair in handles], kind, None, True) for i in (0, 1)
            ]
    result.StatusCode = ua.StatusCode(code)
    return result


# --- views ----------------------------------------------------------------------------------------


def browse(session: Session, params: ua.BrowseParameters) -> Portions:
    """Answer Browse; long answers come in pages."""
    limited(session, params.NodesToBrowse)
    if not params.View.ViewId.is_null():
        raise ServiceError(_Codes.BadViewIdUnknown)
    results, room = [], MAX_REFERENCES_IN_ALL
    for asked in params.NodesToBrowse:
        if session.is_out_of_time:
            result = ua.BrowseResult(StatusCode=ua.StatusCode(_Codes.BadTimeout))
        else:
            most = params.RequestedMaxReferencesPerNode
            result = yield from session.pages.first_page(asked, most, room)
        results.append(result)
        room -= len(result.References or ())
        yield
    return ua.BrowseResponse(Results=results)


def browse_next(session: Session, params: ua.BrowseNextParameters) -> Portions:
    """Answer BrowseNext."""
    results, room = [], MAX_REFERENCES_IN_ALL
    for point in limited(session, params.ContinuationPoints):
        results.append(session.pages.next_page(point, room, params.ReleaseContinuationPoints))
        room -= len(results[-1].References or ())
        yield
    response = ua.BrowseNextResponse()
    response.Parameters.Results = results
    return response


def translate_paths(
    session: Session, params: ua.TranslateBrowsePathsToNodeIdsParameters
) -> Portions:
    """Answer TranslateBrowsePathsToNodeIds."""
    results: list[ua.BrowsePathResult] = []
    server = session.server
    for path in limited(session, params.BrowsePaths):
        if session.is_out_of_time:
            result = ua.BrowsePathResult(StatusCode=ua.StatusCode(_Codes.BadTimeout))
        else:
            result = yield from translate(server.aspace, server.types, path)
        results.append(result)
        yield
    return ua.TranslateBrowsePathsToNodeIdsResponse(Results=results)


def register_nodes(
    session: Session, params: ua.RegisterNodesParameters
) -> ua.RegisterNodesResponse:
    """Answer RegisterNodes: node ids are as fast as handles here, and stay what they are."""
    response = ua.RegisterNodesResponse()
    response.Parameters.RegisteredNodeIds = list(limited(session, params.NodesToRegister))
    return response


def unregister_nodes(
    session: Session, params: ua.UnregisterNodesParameters
) -> ua.UnregisterNodesResponse:
    """Answer UnregisterNodes."""
    limited(session, params.NodesToUnregister)
    return ua.UnregisterNodesResponse()
