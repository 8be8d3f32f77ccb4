"""Services on subscriptions and their monitored items."""

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.io.opcua_server.items import Room
from hilserver.io.opcua_server.operations import check_stamps, limited, status_codes
from hilserver.io.opcua_server.reading import RefusedError
from hilserver.io.opcua_server.sessions import RobotSession

_Codes = ua.StatusCodes


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
    return ua.DeleteSubscriptionsResponse(Results=status_codes(codes))


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
    response.Parameters.Results = status_codes([switch(number) for number in numbers])
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
    stamps, room = check_stamps(params.TimestampsToReturn), _room(session)
    requests = limited(session, params.ItemsToCreate)
    results = [items.create(request, stamps, room) for request in requests]
    items.arrange()
    return ua.CreateMonitoredItemsResponse(Results=results)


def modify_monitored_items(
    session: RobotSession, params: ua.ModifyMonitoredItemsParameters
) -> ua.ModifyMonitoredItemsResponse:
    """Answer ModifyMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    stamps, room = check_stamps(params.TimestampsToReturn), _room(session)
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
    return ua.DeleteMonitoredItemsResponse(Results=status_codes(codes))


def set_monitoring_mode(
    session: RobotSession, params: ua.SetMonitoringModeParameters
) -> ua.SetMonitoringModeResponse:
    """Answer SetMonitoringMode."""
    items, mode = session.own(params.SubscriptionId).items, params.MonitoringMode
    if not isinstance(mode, ua.MonitoringMode):
        raise ServiceError(_Codes.BadMonitoringModeInvalid)
    response = ua.SetMonitoringModeResponse()
    numbers = limited(session, params.MonitoredItemIds)
    response.Parameters.Results = status_codes([items.set_mode(number, mode) for number in numbers])
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
    response.Parameters.AddResults = status_codes(added)
    response.Parameters.RemoveResults = status_codes(removed)
    return response
