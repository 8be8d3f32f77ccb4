"""Services on subscriptions and their monitored items."""

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua.items import Room
from hilserver.opcua.portions import check_stamps, each, limited, status_codes
from hilserver.opcua.reading import RefusedError
from hilserver.opcua.rotation import Portions
from hilserver.opcua.sessions import Session

_Codes = ua.StatusCodes


def create_subscription(
    session: Session, params: ua.CreateSubscriptionParameters
) -> ua.CreateSubscriptionResponse:
    """Answer CreateSubscription."""
    made = session.server.subscription_service.create(session, params)
    return ua.CreateSubscriptionResponse(Parameters=made)


def modify_subscription(
    session: Session, params: ua.ModifySubscriptionParameters
) -> ua.ModifySubscriptionResponse:
    """Answer ModifySubscription; the new interval holds at once."""
    result = ua.ModifySubscriptionResult()
    session.own(params.SubscriptionId).revise(params, result)
    return ua.ModifySubscriptionResponse(Parameters=result)


def delete_subscriptions(session: Session, params: ua.DeleteSubscriptionsParameters) -> Portions:
    """Answer DeleteSubscriptions; those of others do not exist for this session."""

    def delete(number: int) -> int:
        try:
            session.server.subscription_service.remove(session.own(number))
        except ServiceError as error:
            return int(error.code)
        return int(_Codes.Good)

    codes = yield from each(session, limited(session, params.SubscriptionIds), delete, int)
    return ua.DeleteSubscriptionsResponse(Results=status_codes(codes))


def set_publishing_mode(session: Session, params: ua.SetPublishingModeParameters) -> Portions:
    """Answer SetPublishingMode."""

    def switch(number: int) -> int:
        try:
            session.own(number).is_enabled = params.PublishingEnabled
        except ServiceError as error:
            return int(error.code)
        return int(_Codes.Good)

    response = ua.SetPublishingModeResponse()
    codes = yield from each(session, limited(session, params.SubscriptionIds), switch, int)
    response.Parameters.Results = status_codes(codes)
    return response


def republish(session: Session, params: ua.RepublishParameters) -> bytes:
    """Answer Republish with the message as it was sent before."""
    message = session.own(params.SubscriptionId).retained.get(params.RetransmitSequenceNumber)
    if message is None:
        raise ServiceError(_Codes.BadMessageNotAvailable)
    return message


def transfer_subscriptions(
    session: Session, params: ua.TransferSubscriptionsParameters
) -> Portions:
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
        yield
    response = ua.TransferSubscriptionsResponse()
    response.Parameters.Results = results
    return response


# --- monitored items ------------------------------------------------------------------------------


def _room(session: Session) -> Room:
    return session.server.subscription_service.room(session)  # type: ignore[no-any-return]


def create_monitored_items(session: Session, params: ua.CreateMonitoredItemsParameters) -> Portions:
    """Answer CreateMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    stamps, room = check_stamps(params.TimestampsToReturn), _room(session)
    requests = limited(session, params.ItemsToCreate)
    results = yield from each(
        session,
        requests,
        lambda request: items.create(request, stamps, room),
        lambda code: ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(code)),
    )
    items.arrange()
    return ua.CreateMonitoredItemsResponse(Results=results)


def modify_monitored_items(session: Session, params: ua.ModifyMonitoredItemsParameters) -> Portions:
    """Answer ModifyMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    stamps, room = check_stamps(params.TimestampsToReturn), _room(session)
    requests = limited(session, params.ItemsToModify)
    results = yield from each(
        session,
        requests,
        lambda request: items.modify(request, stamps, room),
        lambda code: ua.MonitoredItemModifyResult(StatusCode=ua.StatusCode(code)),
    )
    items.arrange()
    return ua.ModifyMonitoredItemsResponse(Results=results)


def delete_monitored_items(session: Session, params: ua.DeleteMonitoredItemsParameters) -> Portions:
    """Answer DeleteMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    codes = yield from each(session, limited(session, params.MonitoredItemIds), items.delete, int)
    items.arrange()
    return ua.DeleteMonitoredItemsResponse(Results=status_codes(codes))


def set_monitoring_mode(session: Session, params: ua.SetMonitoringModeParameters) -> Portions:
    """Answer SetMonitoringMode."""
    items, mode = session.own(params.SubscriptionId).items, params.MonitoringMode
    if not isinstance(mode, ua.MonitoringMode):
        raise ServiceError(_Codes.BadMonitoringModeInvalid)
    response = ua.SetMonitoringModeResponse()
    codes = yield from each(
        session,
        limited(session, params.MonitoredItemIds),
        lambda number: items.set_mode(number, mode),
        int,
    )
    response.Parameters.Results = status_codes(codes)
    items.arrange()
    return response


def set_triggering(
    session: Session, params: ua.SetTriggeringParameters
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
