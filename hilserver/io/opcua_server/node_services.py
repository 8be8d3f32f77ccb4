"""Services on nodes: Read, Write, Call, and the views."""

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.io.opcua_server import encoding
from hilserver.io.opcua_server.operations import check_stamps, limited, status_codes
from hilserver.io.opcua_server.sessions import RobotSession

_Codes, _Ids = ua.StatusCodes, ua.ObjectIds
_MAX_PATH_ELEMENTS = 50
_SERVER = ua.NodeId(_Ids.Server)
_GET_MONITORED_ITEMS = ua.NodeId(_Ids.Server_GetMonitoredItems)


def read(session: RobotSession, params: encoding.ReadItems) -> list[bytes]:
    """Answer Read with encoded values; what depends on the user is that of this user."""
    items = limited(session, params.items)
    if not params.max_age_ms >= 0:
        raise ServiceError(_Codes.BadMaxAgeInvalid)
    stamps = check_stamps(params.stamps)
    reader, user = session.server.reader, session.user
    return [reader.read(item, user).encoded(stamps) for item in items]


def write(session: RobotSession, params: ua.WriteParameters) -> ua.WriteResponse:
    """Answer Write."""
    answers = session.server.door.write(
        limited(session, params.NodesToWrite), session.user, session.source
    )
    session.texts = [answer.text for answer in answers]
    return ua.WriteResponse(Results=status_codes([answer.code for answer in answers]))


async def call(session: RobotSession, params: ua.CallParameters) -> ua.CallResponse:
    """Answer Call."""
    results: list[ua.CallMethodResult] = []
    texts: list[str] = []
    methods = session.server.methods
    for request in limited(session, params.MethodsToCall):
        text = ""
        if request.MethodId in methods:
            result, text = await methods.call(request, session.user)
        elif request.MethodId == _GET_MONITORED_ITEMS and request.ObjectId == _SERVER:
            result = _monitored_items(session, request.InputArguments or [])
        else:
            is_known = request.MethodId in session.server.aspace
            code = _Codes.BadNotImplemented if is_known else _Codes.BadMethodInvalid
            result = ua.CallMethodResult(StatusCode=ua.StatusCode(code))
        results.append(result)
        texts.append(text)
    session.texts = texts
    return ua.CallResponse(Results=results)


def _monitored_items(session: RobotSession, arguments: list[ua.Variant]) -> ua.CallMethodResult:
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


def browse(session: RobotSession, params: ua.BrowseParameters) -> ua.BrowseResponse:
    """Answer Browse; long answers come in pages."""
    limited(session, params.NodesToBrowse)
    if not params.View.ViewId.is_null():
        raise ServiceError(_Codes.BadViewIdUnknown)
    return ua.BrowseResponse(Results=session.pages.browse(params))


def browse_next(session: RobotSession, params: ua.BrowseNextParameters) -> ua.BrowseNextResponse:
    """Answer BrowseNext."""
    limited(session, params.ContinuationPoints)
    response = ua.BrowseNextResponse()
    response.Parameters.Results = session.pages.browse_next(params)
    return response


def translate(
    session: RobotSession, params: ua.TranslateBrowsePathsToNodeIdsParameters
) -> ua.TranslateBrowsePathsToNodeIdsResponse:
    """Answer TranslateBrowsePathsToNodeIds."""
    results: list[ua.BrowsePathResult] = []
    for path in limited(session, params.BrowsePaths):
        elements = path.RelativePath.Elements or []
        if path.StartingNode not in session.server.aspace:
            code = _Codes.BadNodeIdUnknown
        elif not elements:
            code = _Codes.BadNothingToDo
        elif len(elements) > _MAX_PATH_ELEMENTS:
            code = _Codes.BadTooManyMatches
        else:
            results += session.server.view_service.translate_browsepaths_to_nodeids([path])
            continue
        results.append(ua.BrowsePathResult(StatusCode=ua.StatusCode(code)))
    return ua.TranslateBrowsePathsToNodeIdsResponse(Results=results)


def register_nodes(
    session: RobotSession, params: ua.RegisterNodesParameters
) -> ua.RegisterNodesResponse:
    """Answer RegisterNodes: node ids are as fast as handles here, and stay what they are."""
    response = ua.RegisterNodesResponse()
    response.Parameters.RegisteredNodeIds = list(limited(session, params.NodesToRegister))
    return response


def unregister_nodes(
    session: RobotSession, params: ua.UnregisterNodesParameters
) -> ua.UnregisterNodesResponse:
    """Answer UnregisterNodes."""
    limited(session, params.NodesToUnregister)
    return ua.UnregisterNodesResponse()
