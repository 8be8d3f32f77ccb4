"""Subscriptions within bounds: intervals, queues, notifications per message, modification."""

import asyncio
import time
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.internal_subscription import InternalSubscription
from asyncua.server.subscription_service import SubscriptionService

from hilserver.config.server import OpcUaConfig
from hilserver.io.opcua_server.monitored_items import RobotMonitoredItems

LONGEST_PUBLISHING_MS = 3_600_000.0
MAX_NOTIFICATIONS = 10_000
_OVERFLOW = 0x480
"""InfoType DataValue and Overflow of a status code (OPC 10000-4, 7.39.1)."""
_Codes = ua.StatusCodes


class RobotSubscription(InternalSubscription):  # type: ignore[misc]
    """One subscription.

    Attributes
    ----------
    owner : tuple
        Who created it; the same one may take it over.
    """

    _task: asyncio.Task[None] | None

    def __init__(self, service: "RobotSubscriptions", *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self._service = service
        self.owner: tuple[Any, ...] = ()
        self.max_notifications = MAX_NOTIFICATIONS
        self.monitored_item_srv = RobotMonitoredItems(self, service.aspace)

    def has_room_for_item(self) -> bool:
        """Whether the server may have one more monitored item."""
        return self._service.has_room_for_item()

    # --- queues -----------------------------------------------------------------------------------

    def queue_value(self, mid: int, data: Any, value: ua.DataValue) -> None:
        """Queue a value; what is lost is marked by the overflow bit beside the gap."""
        queue = self._triggered_datachanges.setdefault(mid, [])
        notification = ua.MonitoredItemNotification(ClientHandle=data.client_handle, Value=value)
        if len(queue) < data.queue_size:
            queue.append(notification)
            return
        is_marked = data.queue_size > 1
        if data.discard_oldest:
            queue.append(notification)
            del queue[: len(queue) - data.queue_size]
            marked = 0
        else:
            queue[-1] = notification
            marked = -1
        if is_marked:
            queue[marked] = _with_overflow(queue[marked])

    def shorten_queue(self, mid: int, size: int) -> None:
        """Drop what a shorter queue has no room for; all of it for size 0."""
        for queues in (self._triggered_datachanges, self._triggered_events):
            if size == 0:
                queues.pop(mid, None)
            elif mid in queues:
                del queues[mid][:-size]

    def _has_news(self) -> bool:
        queues = self._triggered_datachanges
        is_reporting = self.monitored_item_srv.is_reporting
        return bool(self._triggered_events) or any(is_reporting(mid) for mid in queues)

    def has_published_results(self) -> bool:
        """Whether there is something to send now, if only a sign of life."""
        self.monitored_item_srv.sample(time.monotonic())
        if self._triggered_statuschanges or (self._publishing_enabled and self._has_news()):
            return True
        if self._startup:
            return True
        self._keep_alive_count += 1
        return bool(self._keep_alive_count >= self.data.RevisedMaxKeepAliveCount)

    async def publish_results(self, requestdata: Any = None) -> bool:
        """Publish; again as long as there is more than one message may hold."""
        is_sent = bool(await super().publish_results(requestdata))
        is_more = is_sent
        while is_more and self._publishing_enabled and self._has_news():
            is_more = bool(await super().publish_results())
        return is_sent

    def _pop_publish_result(self) -> ua.PublishResult:
        result = super()._pop_publish_result()
        result.MoreNotifications = self._publishing_enabled and self._has_news()
        return result

    def _pop_triggered_datachanges(self, result: ua.PublishResult) -> None:
        items = self._take(self._triggered_datachanges, self.max_notifications, reporting=True)
        if items:
            notification = ua.DataChangeNotification(MonitoredItems=items)
            result.NotificationMessage.NotificationData.append(notification)

    def _pop_triggered_events(self, result: ua.PublishResult) -> None:
        data = result.NotificationMessage.NotificationData
        room = self.max_notifications - sum(len(part.MonitoredItems) for part in data)
        events = self._take(self._triggered_events, room, reporting=False)
        if events:
            data.append(ua.EventNotificationList(Events=events))

    def _take(self, queues: dict[int, list[Any]], room: int, *, reporting: bool) -> list[Any]:
        taken: list[Any] = []
        for mid in tuple(queues):
            if reporting and not self.monitored_item_srv.is_reporting(mid):
                continue
            part = queues[mid][: room - len(taken)]
            taken += part
            del queues[mid][: len(part)]
            if not queues[mid]:
                del queues[mid]
            if len(taken) >= room:
                break
        return taken

    # --- the publishing loop ----------------------------------------------------------------------

    def restart(self) -> None:
        """Publish at the interval that holds now."""
        if self._task is not None:
            self._task.cancel()
            self._task = asyncio.create_task(self._subscription_loop(at_once=False))

    async def _subscription_loop(self, at_once: bool = True) -> None:
        period_s = self.data.RevisedPublishingInterval / 1e3
        next_s = time.monotonic()
        if at_once:
            await self.publish_results()
        while not self._closing:
            # What a late loop has missed is not caught up.
            next_s = max(next_s + period_s, time.monotonic())
            await asyncio.sleep(next_s - time.monotonic())
            await self.publish_results()


def _with_overflow(notification: ua.MonitoredItemNotification) -> ua.MonitoredItemNotification:
    value = notification.Value
    code = 0 if value.StatusCode is None else value.StatusCode.value
    marked = ua.DataValue(
        value.Value,
        ua.StatusCode(code | _OVERFLOW),
        value.SourceTimestamp,
        value.ServerTimestamp,
        value.SourcePicoseconds,
        value.ServerPicoseconds,
    )
    return ua.MonitoredItemNotification(ClientHandle=notification.ClientHandle, Value=marked)


class RobotSubscriptions(SubscriptionService):  # type: ignore[misc]
    """All subscriptions of the server."""

    def __init__(self, iserver: Any, config: OpcUaConfig) -> None:
        super().__init__(iserver.aspace, iserver=iserver)
        self._config = config

    def of(self, session: Any) -> list[RobotSubscription]:
        """Return the subscriptions of a session."""
        return [s for s in self.subscriptions.values() if s.session_id == session.session_id]

    def has_room_for_item(self) -> bool:
        """Whether there may be one more monitored item."""
        count = sum(len(s.monitored_item_srv) for s in self.subscriptions.values())
        return count < self._config.max_monitored_items

    async def create_subscription(
        self,
        params: ua.CreateSubscriptionParameters,
        callback: Any,
        session_id: ua.NodeId,
        request_callback: Any = None,
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription; what is asked for is revised into bounds."""
        if len(self.subscriptions) >= self._config.max_subscriptions:
            raise ServiceError(_Codes.BadTooManySubscriptions)
        result = ua.CreateSubscriptionResult()
        self._revise(params, result)
        self._sub_id_counter += 1
        number = result.SubscriptionId = self._sub_id_counter
        subscription = RobotSubscription(
            self,
            result,
            self.aspace,
            callback,
            session_id,
            request_callback=request_callback,
            delete_callback=lambda: self.subscriptions.pop(number, None),
            no_acks_limit=self.iserver.max_unacked_messages_per_subscription,
            max_queue_size=self._config.max_queue_size,
            publishing_enabled=params.PublishingEnabled,
        )
        subscription.max_notifications = _notifications(params.MaxNotificationsPerPublish)
        await subscription.start()
        self.subscriptions[number] = subscription
        return result

    def modify_subscription(
        self, params: ua.ModifySubscriptionParameters
    ) -> ua.ModifySubscriptionResult:
        """Change a subscription; the new interval holds at once."""
        subscription = self.subscriptions.get(params.SubscriptionId)
        if subscription is None:
            raise ServiceError(_Codes.BadSubscriptionIdInvalid)
        result = ua.ModifySubscriptionResult()
        self._revise(params, result)
        self._revise(params, subscription.data)
        subscription.max_notifications = _notifications(params.MaxNotificationsPerPublish)
        subscription.restart()
        return result

    def _revise(self, params: Any, result: Any) -> None:
        shortest = self._config.min_publishing_ms
        asked_ms = params.RequestedPublishingInterval
        # `not >=` also catches NaN.
        interval_ms = shortest if not asked_ms >= shortest else min(asked_ms, LONGEST_PUBLISHING_MS)
        result.RevisedPublishingInterval = interval_ms
        keep_alive = self._clamp_keep_alive_count(params.RequestedMaxKeepAliveCount)
        result.RevisedMaxKeepAliveCount = keep_alive
        lifetime = self._clamp_lifetime_count(params.RequestedLifetimeCount)
        result.RevisedLifetimeCount = max(lifetime, 3 * keep_alive)


def _notifications(asked: int) -> int:
    return min(int(asked), MAX_NOTIFICATIONS) if asked else MAX_NOTIFICATIONS
