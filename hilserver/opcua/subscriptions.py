"""Subscriptions: samples are sent at the publishing interval, within bounds.

The states are those of OPC 10000-4, 5.13.1.2. A subscription has turns like every other job of the
server (`rotation`): one message per turn, so that a long queue does not delay others.
"""

import time
from collections import OrderedDict, deque
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua import encoding
from hilserver.opcua.browsing import TypeTree
from hilserver.opcua.items import FixedEvent, Room
from hilserver.opcua.logs import log
from hilserver.opcua.monitored_items import GIVE_WAY_EVERY, MonitoredItems
from hilserver.opcua.rotation import Portions, Rotation, advance
from hilserver.opcua.settings import OpcUaSettings, OpcUaShare
from hilserver.period import Period

LONGEST_LIFETIME_S = 600.0
"""Without its client a subscription ends within this time and a third, whatever its cycle."""
# OPC 10000-4, 5.14.2: three times as often
LONGEST_KEEP_ALIVE_S = LONGEST_LIFETIME_S / 3
LONGEST_PUBLISHING_MS = LONGEST_KEEP_ALIVE_S * 1e3
MAX_NOTIFICATIONS = 1000
_MAX_MESSAGE_BYTES = 48 * 1024
_MAX_RETAINED, _MAX_RETAINED_BYTES = 100, 128 * 1024
_ANSWER_BYTES = 1024  # upper limit for a Publish response without its notifications
_MAX_SEQUENCE = 2**32 - 1
_MAX_EVENTS = 100  # waiting to be filtered
_Codes = ua.StatusCodes


class Subscription:
    """One subscription."""

    def __init__(self, service: "Subscriptions", number: int, session: Any) -> None:
        # its creator is the owner, who may take it over in another session
        self.number = number
        self.session = session
        self.owner = session.owner
        self.revised = ua.CreateSubscriptionResult(SubscriptionId=number)
        self.is_enabled = True
        self.max_notifications = MAX_NOTIFICATIONS
        self.items = MonitoredItems(
            service.address_space,
            service.types,
            service.settings,
            lambda: float(self.revised.RevisedPublishingInterval),
        )
        # messages not acknowledged yet, by sequence number
        self.retained: OrderedDict[int, bytes] = OrderedDict()
        self._retained_bytes = 0
        self._service = service
        self._sequence = 1
        self._period = Period(self._tick)
        self._is_due = self._is_owed = self._has_frame = False
        self.used_s = 0.0
        self._events: deque[FixedEvent] = deque(maxlen=_MAX_EVENTS)
        self._work: Portions | None = None
        self._is_first = True
        self._idle_cycles = self._unserved_cycles = 0

    # --- services ---------------------------------------------------------------------------------

    def revise(self, params: Any, result: Any) -> None:
        """Take over the requested intervals and limits, within bounds."""
        shortest = self._service.settings.min_publishing_ms
        asked_ms = params.RequestedPublishingInterval
        # `not >=` also catches NaN.
        if not asked_ms >= shortest:
            interval_ms = shortest
        else:
            interval_ms = min(asked_ms, LONGEST_PUBLISHING_MS)
        # Agreed on as counts of cycles, but a budget is a time.
        most = int(LONGEST_PUBLISHING_MS // interval_ms)
        keep_alive = _bounded(params.RequestedMaxKeepAliveCount, most)
        lifetime = max(
            _bounded(params.RequestedLifetimeCount, 3 * most), 3 * keep_alive
        )
        for target in (result, self.revised):
            target.RevisedPublishingInterval = interval_ms
            target.RevisedMaxKeepAliveCount = keep_alive
            target.RevisedLifetimeCount = lifetime
        asked = params.MaxNotificationsPerPublish
        if asked:
            self.max_notifications = min(asked, MAX_NOTIFICATIONS)
        else:
            self.max_notifications = MAX_NOTIFICATIONS
        self._unserved_cycles = 0
        self.start()

    def start(self) -> None:
        """Start a publishing interval now."""
        interval_s = self.revised.RevisedPublishingInterval / 1e3
        self._period.start(interval_s, 0.0 if self._is_first else interval_s)

    def stop(self) -> None:
        """Stop publishing and give up its turns."""
        self._period.stop()
        self._service.rotation.drop(self)

    def _tick(self) -> None:
        self._is_due = True
        self._service.rotation.add(self)

    def acknowledge(self, sequence: int) -> bool:
        """Forget a message that has arrived; False if it is not known."""
        message = self.retained.pop(sequence, None)
        self._retained_bytes -= len(message or b"")
        return message is not None

    def serve(self, session: Any) -> None:
        """Move to another session."""
        self.session = session
        self._unserved_cycles = 0
        if self._is_owed:
            self._service.rotation.add(self)

    # --- turns ------------------------------------------------------------------------------------

    def after_frame(self) -> bool:
        """Note a new frame; return whether a turn is needed for it."""
        self._has_frame = self.items.has_each_frame
        return self._has_frame

    def take_event(self, event: FixedEvent) -> None:
        """Keep an event for the next turn, if events are monitored; the oldest makes room."""
        if self.items.has_events:
            self._events.append(event)
            self._service.rotation.add(self)

    def turn(self) -> bool:
        """Sample, and send a message if it is time; return whether there is more to do now."""
        if self._work is None:
            work = self._sample()
            if not self._events and len(self.items) <= GIVE_WAY_EVERY:
                deque(work, 0)  # in one go: no frame comes in between
                return self._is_owed and self._send()
            self._work = work
        try:
            advance(self._work)
        except StopIteration:
            self._work = None
            return self._is_owed and self._send()
        except Exception:
            self._work = None
            raise
        return True

    def _sample(self) -> Portions:
        """Filter waiting events, and sample all items that are due, in portions."""
        while self._events:
            yield from self.items.take_event(self._events.popleft())
        now_s = time.monotonic()
        if self._has_frame:
            self._has_frame = False
            yield from self.items.after_frame(now_s)
        if self._is_due:
            self._is_due = False
            yield from self.items.before_publishing(now_s)
            self._cycle()

    def _cycle(self) -> None:
        if self._is_owed:
            self._unserved_cycles += 1
            if self._unserved_cycles > self.revised.RevisedLifetimeCount:
                log.info("opcua subscription expired", subscription=self.number)
                self._service.remove(self, _Codes.BadTimeout)
                return
        self._idle_cycles += 1
        is_idle = self._idle_cycles >= self.revised.RevisedMaxKeepAliveCount
        if self._is_first or self._has_news() or is_idle:
            self._is_owed = True

    def _has_news(self) -> bool:
        return self.is_enabled and bool(self.items.ready)

    def _send(self) -> bool:
        request = self.session.take_publish_request(self)
        if request is None:
            return False
        data = self._take(self.session.max_response_bytes) if self.is_enabled else []
        self._idle_cycles = self._unserved_cycles = 0
        self._is_first = False
        self._is_owed = is_more = self._has_news()
        message = encoding.notification_message(self._sequence, data)
        if data:
            self.retained[self._sequence] = message
            self._retained_bytes += len(message)
            self._sequence = self._sequence % _MAX_SEQUENCE + 1
            while len(self.retained) > 1 and (
                len(self.retained) > _MAX_RETAINED
                or self._retained_bytes > _MAX_RETAINED_BYTES
            ):
                _, oldest = self.retained.popitem(last=False)
                self._retained_bytes -= len(oldest)
        self.session.answer_publish(
            request, self.number, list(self.retained), is_more, message
        )
        return is_more

    def _take(self, longest: int) -> list[bytes]:
        """Return as many notifications as a message may hold."""
        room = min(longest, _MAX_MESSAGE_BYTES) if longest else _MAX_MESSAGE_BYTES
        room -= _ANSWER_BYTES + 4 * len(self.retained)
        parts: dict[bytes, list[bytes]] = {
            encoding.DATA_CHANGE: [],
            encoding.EVENTS: [],
        }
        count = 0
        ready = self.items.ready
        for number, item in tuple(ready.items()):
            own = parts[item.kind]
            while item.queue and count < self.max_notifications and room > 0:
                own.append(item.pop())
                count += 1
                room -= len(own[-1])
            if item.queue:
                break
            del ready[number]
        return [
            encoding.notification_list(kind, own) for kind, own in parts.items() if own
        ]


def _bounded(asked: int, most: int) -> int:
    return min(asked, most) if asked > 0 else most


class Subscriptions:
    """All subscriptions of the server.

    The limits of a session depend on the role of its user (`limits`), those for all sessions
    together on the server (`max_*`). If the total is exhausted, subscriptions whose client has
    lost its connection yield, the oldest first.
    """

    def __init__(
        self, address_space: Any, types: TypeTree, settings: OpcUaSettings
    ) -> None:
        self.address_space = address_space
        self.types = types
        self.settings = settings
        self.rotation = Rotation()
        self.subscriptions: dict[int, Subscription] = {}
        self._number = 77

    def of(self, session: Any) -> list[Subscription]:
        """Return the subscriptions of a session."""
        return [s for s in self.subscriptions.values() if s.session is session]

    def after_frame(self) -> None:
        """Give turns to subscriptions that need every change."""
        for subscription in self.subscriptions.values():
            if subscription.after_frame():
                self.rotation.add(subscription)
        self.rotation.run_now()

    def take_event(self, event: FixedEvent) -> None:
        """Queue an event in all subscriptions."""
        for subscription in self.subscriptions.values():
            subscription.take_event(event)

    async def trigger_event(self, event: Any, subscription_id: None = None) -> None:  # noqa: ARG002
        """Queue an event of asyncua's event generators."""
        found = {
            name: (getattr(event, name), kind)
            for name, kind in event.data_types.items()
        }
        fields = {
            name: ua.Variant(*row) for name, row in found.items() if row[0] is not None
        }
        self.take_event(FixedEvent(event.emitting_node, fields))

    def create(self, session: Any, params: Any) -> ua.CreateSubscriptionResult:
        """Create a subscription; BadTooManySubscriptions if there is no room."""
        if len(self.of(session)) >= self._share(session).subscriptions:
            raise ServiceError(_Codes.BadTooManySubscriptions)
        if len(self.subscriptions) >= self.settings.max_subscriptions:
            self._drop_orphan()
        if len(self.subscriptions) >= self.settings.max_subscriptions:
            raise ServiceError(_Codes.BadTooManySubscriptions)
        self._number += 1
        subscription = Subscription(self, self._number, session)
        subscription.is_enabled = params.PublishingEnabled
        self.subscriptions[self._number] = subscription
        result = ua.CreateSubscriptionResult(SubscriptionId=self._number)
        subscription.revise(params, result)
        return result

    def remove(self, subscription: Subscription, reason: int = 0) -> None:
        """Delete a subscription; send `reason` if its client did not request this."""
        if self.subscriptions.pop(subscription.number, None) is None:
            return
        subscription.stop()
        subscription.session.forget(subscription, reason)

    def room(self, session: Any) -> Room:
        """Return what a session may still monitor; orphans yield if nothing is left."""
        share = self._share(session)
        own = self.of(session)
        n_items = sum(len(s.items) for s in own)
        n_values = sum(s.items.queued_values for s in own)
        room = Room(share.monitored_items - n_items, share.queued_values - n_values)
        while True:
            everybody = self.subscriptions.values()
            items = self.settings.max_monitored_items - sum(
                len(s.items) for s in everybody
            )
            if items > 0 or room.items <= 0 or not self._drop_orphan():
                break
        queued = self.settings.max_queued_values - sum(
            s.items.queued_values for s in everybody
        )
        return Room(min(room.items, items), max(0, min(room.queued_values, queued)))

    def _share(self, session: Any) -> OpcUaShare:
        return self.settings.limits.of(session.user.rights)

    def _drop_orphan(self) -> bool:
        everybody = self.subscriptions.values()
        orphan = next((s for s in everybody if s.session.processor is None), None)
        if orphan is None:
            return False
        log.info(
            "opcua subscription without a connection makes room",
            subscription=orphan.number,
        )
        self.remove(orphan, _Codes.BadTimeout)
        return True
