"""The services of a session (OPC 10000-4): each takes its parameters and returns its response.

Where a list of operations is asked for, each has a status code of its own; what concerns the whole
request is raised as ServiceError. Call may wait and is a coroutine.
"""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.io.opcua_server import encoding
from hilserver.io.opcua_server.items import Room
from hilserver.io.opcua_server.reading import RefusedError
from hilserver.io.opcua_server.sessions import RobotSession

_Codes, _Ids = ua.StatusCodes, ua.ObjectIds
_MAX_PATH_ELEMENTS = 50
_SERVER = ua.NodeId(_Ids.Server)
_GET_MONITORED_ITEMS = ua.NodeId(_Ids.Server_GetMonitoredItems)


def limited(session: RobotSession, items: Sequence[Any] | None) -> Sequence[Any]:
    """Return `items` if a request may have so many."""
    if not items:
        raise ServiceError(_Codes.BadNothingToDo)
    if len(items) > session.server.config.max_operations:
        raise ServiceError(_Codes.BadTooManyOperations)
    return items


def _codes(codes: Sequence[int]) -> list[ua.StatusCode]:
    return [ua.StatusCode(code) for code in codes]


def _check_stamps(stamps: int) -> int:
    if stamps in (0, 1, 2, 3):
        return int(stamps)
    raise ServiceError(_Codes.BadTimestampsToReturnInvalid)


# --- values and methods ---------------------------------------------------------------------------


def read(session: RobotSession, params: encoding.ReadItems) -> list[bytes]:
    """Answer Read with encoded values; what depends on the user is that of this user."""
    items = limited(session, params.items)
    if not params.max_age_ms >= 0:
        raise ServiceError(_Codes.BadMaxAgeInvalid)
    stamps = _check_stamps(params.stamps)
    reader, user = session.server.reader, session.user
    return [reader.read(item, user).encoded(stamps) for item in items]


def write(session: RobotSession, params: ua.WriteParameters) -> ua.WriteResponse:
    """Answer Write."""
    answers = session.server.door.write(
        limited(session, params.NodesToWrite), session.user, session.source
    )
    session.texts = [answer.text for answer in answers]
    return ua.WriteResponse(Results=_codes([answer.code for answer in answers]))


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
        result.InputArgumentResults = _codes([_Codes.BadTypeMismatch])
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


# --- subscriptions --------------------------------------------------------------------------------


def create_subscription(
    session: RobotSession, params: ua.CreateSubscriptionParameters
) -> ua.CreateSubscriptionResponse:
    """Answer CreateSubscription."""
    made = session.server.subscription_service.create(session, params)
    return ua.CreateSubscriptionResponse(Parameters=made)


def modify_subscription(
    session: RobotSession, params: ua.ModifySubscriptionParameters
) -> ua.ModifySubscriptionResponse:
    """Answer ModifySubscription; the new interval holds at once."""
    result = ua.ModifySubscriptionResult()
    session.own(params.SubscriptionId).revise(params, result)
    return ua.ModifySubscriptionResponse(Parameters=result)


def delete_subscriptions(
    session: RobotSession, params: ua.DeleteSubscriptionsParameters
) -> ua.DeleteSubscriptionsResponse:
    """Answer DeleteSubscriptions; those of others do not exist for this session."""

    def delete(number: int) -> int:
        try:
            session.server.subscription_service.remove(session.own(number))
        except ServiceError as error:
            return int(error.code)
        return int(_Codes.Good)

    codes = [delete(number) for number in limited(session, params.SubscriptionIds)]
    return ua.DeleteSubscriptionsResponse(Results=_codes(codes))


def set_publishing_mode(
    session: RobotSession, params: ua.SetPublishingModeParameters
) -> ua.SetPublishingModeResponse:
    """Answer SetPublishingMode."""

    def switch(number: int) -> int:
        try:
            session.own(number).is_enabled = params.PublishingEnabled
        except ServiceError as error:
            return int(error.code)
        return int(_Codes.Good)

    response = ua.SetPublishingModeResponse()
    numbers = limited(session, params.SubscriptionIds)
    response.Parameters.Results = _codes([switch(number) for number in numbers])
    return response


def republish(session: RobotSession, params: ua.RepublishParameters) -> bytes:
    """Answer Republish with the message as it was sent before."""
    message = session.own(params.SubscriptionId).retained.get(params.RetransmitSequenceNumber)
    if message is None:
        raise ServiceError(_Codes.BadMessageNotAvailable)
    return message


def transfer_subscriptions(
    session: RobotSession, params: ua.TransferSubscriptionsParameters
) -> ua.TransferSubscriptionsResponse:
    """Answer TransferSubscriptions: to the same user of the same program."""
    service = session.server.subscription_service
    results: list[ua.TransferResult] = []
    for number in limited(session, params.SubscriptionIds):
        found = service.subscriptions.get(number)
        result = ua.TransferResult()
        if found is None:
            code = _Codes.BadSubscriptionIdInvalid
        elif found.owner != session.owner or not session.is_known:
            code = _Codes.BadUserAccessDenied
        elif found.session is session:
            code = _Codes.BadNothingToDo
        else:
            code = _Codes.Good
            found.session.forget(found, _Codes.GoodSubscriptionTransferred)
            if params.SendInitialValues:
                found.items.repeat_values()
            found.serve(session)
            result.AvailableSequenceNumbers = list(found.retained)
        result.StatusCode = ua.StatusCode(code)
        results.append(result)
    response = ua.TransferSubscriptionsResponse()
    response.Parameters.Results = results
    return response


# --- monitored items ------------------------------------------------------------------------------


def _room(session: RobotSession) -> Room:
    return session.server.subscription_service.room(session)  # type: ignore[no-any-return]


def create_monitored_items(
    session: RobotSession, params: ua.CreateMonitoredItemsParameters
) -> ua.CreateMonitoredItemsResponse:
    """Answer CreateMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    stamps, room = _check_stamps(params.TimestampsToReturn), _room(session)
    requests = limited(session, params.ItemsToCreate)
    results = [items.create(request, stamps, room) for request in requests]
    items.arrange()
    return ua.CreateMonitoredItemsResponse(Results=results)


def modify_monitored_items(
    session: RobotSession, params: ua.ModifyMonitoredItemsParameters
) -> ua.ModifyMonitoredItemsResponse:
    """Answer ModifyMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    stamps, room = _check_stamps(params.TimestampsToReturn), _room(session)
    requests = limited(session, params.ItemsToModify)
    results = [items.modify(request, stamps, room) for request in requests]
    items.arrange()
    return ua.ModifyMonitoredItemsResponse(Results=results)


def delete_monitored_items(
    session: RobotSession, params: ua.DeleteMonitoredItemsParameters
) -> ua.DeleteMonitoredItemsResponse:
    """Answer DeleteMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    codes = [items.delete(number) for number in limited(session, params.MonitoredItemIds)]
    items.arrange()
    return ua.DeleteMonitoredItemsResponse(Results=_codes(codes))


def set_monitoring_mode(
    session: RobotSession, params: ua.SetMonitoringModeParameters
) -> ua.SetMonitoringModeResponse:
    """Answer SetMonitoringMode."""
    items, mode = session.own(params.SubscriptionId).items, params.MonitoringMode
    if not isinstance(mode, ua.MonitoringMode):
        raise ServiceError(_Codes.BadMonitoringModeInvalid)
    response = ua.SetMonitoringModeResponse()
    numbers = limited(session, params.MonitoredItemIds)
    response.Parameters.Results = _codes([items.set_mode(number, mode) for number in numbers])
    items.arrange()
    return response


def set_triggering(
    session: RobotSession, params: ua.SetTriggeringParameters
) -> ua.SetTriggeringResponse:
    """Answer SetTriggering."""
    items = session.own(params.SubscriptionId).items
    add, remove = list(params.LinksToAdd or ()), list(params.LinksToRemove or ())
    limited(session, add + remove)
    try:
        added, removed = items.trigger(params.TriggeringItemId, add, remove)
    except RefusedError as error:
        raise ServiceError(error.code) from None
    response = ua.SetTriggeringResponse()
    response.Parameters.AddResults = _codes(added)
    response.Parameters.RemoveResults = _codes(removed)
    return response


class Service(NamedTuple):
    """A service: how its parameters are called, and who answers."""

    parameters: type
    answer: Callable[[RobotSession, Any], Any]


def _id(request: str) -> int:
    return int(getattr(_Ids, f"{request}Request_Encoding_DefaultBinary"))


SERVICES: dict[int, Service] = {
    _id("Write"): Service(ua.WriteParameters, write),
    _id("Call"): Service(ua.CallParameters, call),
    _id("Browse"): Service(ua.BrowseParameters, browse),
    _id("BrowseNext"): Service(ua.BrowseNextParameters, browse_next),
    _id("TranslateBrowsePathsToNodeIds"): Service(
        ua.TranslateBrowsePathsToNodeIdsParameters, translate
    ),
    _id("RegisterNodes"): Service(ua.RegisterNodesParameters, register_nodes),
    _id("UnregisterNodes"): Service(ua.UnregisterNodesParameters, unregister_nodes),
    _id("CreateSubscription"): Service(ua.CreateSubscriptionParameters, create_subscription),
    _id("ModifySubscription"): Service(ua.ModifySubscriptionParameters, modify_subscription),
    _id("DeleteSubscriptions"): Service(ua.DeleteSubscriptionsParameters, delete_subscriptions),
    _id("SetPublishingMode"): Service(ua.SetPublishingModeParameters, set_publishing_mode),
    _id("TransferSubscriptions"): Service(
        ua.TransferSubscriptionsParameters, transfer_subscriptions
    ),
    _id("CreateMonitoredItems"): Service(ua.CreateMonitoredItemsParameters, create_monitored_items),
    _id("ModifyMonitoredItems"): Service(ua.ModifyMonitoredItemsParameters, modify_monitored_items),
    _id("DeleteMonitoredItems"): Service(ua.DeleteMonitoredItemsParameters, delete_monitored_items),
    _id("SetMonitoringMode"): Service(ua.SetMonitoringModeParameters, set_monitoring_mode),
    _id("SetTriggering"): Service(ua.SetTriggeringParameters, set_triggering),
}
REPUBLISH = Service(ua.RepublishParameters, republish)
