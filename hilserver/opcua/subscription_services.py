"""Services on subscriptions and their monitored items."""

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua.portions import check_stamps, each, limited, status_codes
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
    """Answer ModifySubscription; the new interval applies at once."""
    result = ua.ModifySubscriptionResult()
    session.own(params.SubscriptionId).revise(params, result)
    return ua.ModifySubscriptionResponse(Parameters=result)


def delete_subscriptions(
    session: Session, params: ua.DeleteSubscriptionsParameters
) -> Portions:
    """Answer DeleteSubscriptions; those of others do not exist for this session."""

    def delete(number: int) -> None:
        session.server.subscription_service.remove(session.own(number))

    return each(
        session, params.SubscriptionIds, delete, ua.DeleteSubscriptionsResponse()
    )


def set_publishing_mode(
    session: Session, params: ua.SetPublishingModeParameters
) -> Portions:
    """Answer SetPublishingMode."""

    def switch(number: int) -> None:
        session.own(number).is_enabled = params.PublishingEnabled

    return each(session, params.SubscriptionIds, switch, ua.SetPublishingModeResponse())


def republish(session: Session, params: ua.RepublishParameters) -> bytes:
    """Answer Republish with the message exactly as sent before."""
    message = session.own(params.SubscriptionId).retained.get(
        params.RetransmitSequenceNumber
    )
    if message is None:
        raise ServiceError(_Codes.BadMessageNotAvailable)
    return message


def transfer_subscriptions(
    session: Session, params: ua.TransferSubscriptionsParameters
) -> Portions:
    """Answer TransferSubscriptions: only to the same user of the same program."""
    subscriptions = session.server.subscription_service.subscriptions

    def transfer(number: int) -> ua.TransferResult:
        found = subscriptions.get(number)
        if found is None:
            raise ServiceError(_Codes.BadSubscriptionIdInvalid)
        if found.owner != session.owner or not session.is_known:
            raise ServiceError(_Codes.BadUserAccessDenied)
        if found.session is session:
            raise ServiceError(_Codes.BadNothingToDo)
        found.session.forget(found, _Codes.GoodSubscriptionTransferred)
        if params.SendInitialValues:
            found.items.repeat_values()
        found.serve(session)
        return ua.TransferResult(AvailableSequenceNumbers=list(found.retained))

    response = ua.TransferSubscriptionsResponse()
    return each(session, params.SubscriptionIds, transfer, response, ua.TransferResult)


# --- monitored items ------------------------------------------------------------------------------


def create_monitored_items(
    session: Session, params: ua.CreateMonitoredItemsParameters
) -> Portions:
    """Answer CreateMonitoredItems."""
    items, response = (
        session.own(params.SubscriptionId).items,
        ua.CreateMonitoredItemsResponse(),
    )
    stamps = check_stamps(params.TimestampsToReturn)
    room = session.server.subscription_service.room(session)

    def create(request: ua.MonitoredItemCreateRequest) -> ua.MonitoredItemCreateResult:
        return items.create(request, stamps, room)

    return each(
        session, params.ItemsToCreate, create, response, ua.MonitoredItemCreateResult
    )


def modify_monitored_items(
    session: Session, params: ua.ModifyMonitoredItemsParameters
) -> Portions:
    """Answer ModifyMonitoredItems."""
    items, response = (
        session.own(params.SubscriptionId).items,
        ua.ModifyMonitoredItemsResponse(),
    )
    stamps = check_stamps(params.TimestampsToReturn)
    room = session.server.subscription_service.room(session)

    def modify(request: ua.MonitoredItemModifyRequest) -> ua.MonitoredItemModifyResult:
        return items.modify(request, stamps, room)

    return each(
        session, params.ItemsToModify, modify, response, ua.MonitoredItemModifyResult
    )


def delete_monitored_items(
    session: Session, params: ua.DeleteMonitoredItemsParameters
) -> Portions:
    """Answer DeleteMonitoredItems."""
    items = session.own(params.SubscriptionId).items
    return each(
        session,
        params.MonitoredItemIds,
        items.delete,
        ua.DeleteMonitoredItemsResponse(),
    )


def set_monitoring_mode(
    session: Session, params: ua.SetMonitoringModeParameters
) -> Portions:
    """Answer SetMonitoringMode."""
    items = session.own(params.SubscriptionId).items
    mode = params.MonitoringMode
    if not isinstance(mode, ua.MonitoringMode):
        raise ServiceError(_Codes.BadMonitoringModeInvalid)

    def switch(number: int) -> None:
        items.set_mode(number, mode)

    return each(
        session, params.MonitoredItemIds, switch, ua.SetMonitoringModeResponse()
    )


def set_triggering(
    session: Session, params: ua.SetTriggeringParameters
) -> ua.SetTriggeringResponse:
    """Answer SetTriggering."""
    items = session.own(params.SubscriptionId).items
    add = list(params.LinksToAdd or ())
    remove = list(params.LinksToRemove or ())
    limited(session, add + remove)
    added, removed = items.trigger(params.TriggeringItemId, add, remove)
    response = ua.SetTriggeringResponse()
    response.Parameters.AddResults = status_codes(added)
    response.Parameters.RemoveResults = status_codes(removed)
    return response
