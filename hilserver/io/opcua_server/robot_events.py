"""Events of the daemon as OPC UA events: own types, on the Server object and on the robot.

At most `max_events_per_s` of one kind are sent in a second. What is left out is counted, and the
count travels with the next event of that kind (property Suppressed), at the latest with a summary
when the flood is over.
"""

import time
import uuid
from collections.abc import Callable
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from hilserver.clock import UtcClock
from hilserver.events import Event, EventBus, EventKind
from hilserver.io.opcua_server.address_space import SERVER, AddressSpaceBuilder
from hilserver.io.opcua_server.values import run_to_end

BASE_TYPE = "RobotEventType"
TYPE_NAMES: dict[EventKind, str] = {
    EventKind.OVERRUN: "OverrunEventType",
    EventKind.PEER_LOST: "PeerLostEventType",
    EventKind.PEER_RESTORED: "PeerRestoredEventType",
    EventKind.PEER_FAULT: "PeerFaultEventType",
    EventKind.SETPOINT_REFUSED: "SetPointRefusedEventType",
    EventKind.SAFE_STATE: "SafeStateEventType",
    EventKind.STATE: "StateChangedEventType",
}
_WINDOW_S = 1.0
_Type = ua.VariantType
_NULL = ua.Variant()


class RobotEvent:
    """One event as asyncua's subscriptions want it: plain attributes, and fields on request."""

    def __init__(self, emitting_node: ua.NodeId, fields: dict[str, ua.Variant]) -> None:
        self.emitting_node = emitting_node
        self._fields = fields
        # Where-clauses of clients look attributes up by name.
        self.__dict__.update({name: field.Value for name, field in fields.items()})

    def to_event_fields(self, select_clauses: list[ua.SimpleAttributeOperand]) -> list[ua.Variant]:
        """Return the fields a client selected; null for those that do not exist."""
        names = ("/".join(part.Name or "" for part in c.BrowsePath) for c in select_clauses)
        return [self._fields.get(name, _NULL) for name in names]


class RobotEvents:
    """Sends the events of the bus to OPC UA clients.

    Parameters
    ----------
    subscriptions : asyncua SubscriptionService
    limit_per_s : int
        Events of one kind that are sent in a second.
    """

    def __init__(
        self,
        builder: AddressSpaceBuilder,
        subscriptions: Any,
        clock: UtcClock,
        *,
        limit_per_s: int,
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._subscriptions = subscriptions
        self._clock = clock
        self._monotonic_s = monotonic_s
        self._robot = builder.robot
        self._types = _add_types(builder)
        self._limits = {kind: _Limit(limit_per_s) for kind in EventKind}
        self._unsubscribe: Callable[[], None] | None = None

    def attach(self, bus: EventBus) -> None:
        """Send every later event of `bus`."""
        self._unsubscribe = bus.subscribe(self.send)

    def detach(self) -> None:
        """Send no more."""
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def send(self, event: Event) -> None:
        """Send one event, or count it if there were too many of its kind."""
        limit = self._limits[event.kind]
        if limit.admits(self._monotonic_s(), event):
            self._emit(event, limit.take_suppressed())

    def flush(self) -> None:
        """Send a summary of what was left out, once its kind has become quiet."""
        for limit in self._limits.values():
            event = limit.last
            if limit.suppressed and event and limit.admits(self._monotonic_s(), event):
                # The summary repeats an event that is itself one of those left out.
                self._emit(event, limit.take_suppressed() - 1)

    def _emit(self, event: Event, suppressed: int) -> None:
        fields = self._fields(event, suppressed)
        for node_id in (SERVER, self._robot):
            robot_event = RobotEvent(node_id, fields)
            for subscription in tuple(self._subscriptions.subscriptions.values()):
                run_to_end(subscription.monitored_item_srv.trigger_event(robot_event), "event")

    def _fields(self, event: Event, suppressed: int) -> dict[str, ua.Variant]:
        message = event.message + (f" (and {suppressed} more)" if suppressed else "")
        return {
            "EventId": ua.Variant(uuid.uuid4().bytes, _Type.ByteString),
            "EventType": ua.Variant(self._types[event.kind], _Type.NodeId),
            "SourceNode": ua.Variant(self._robot, _Type.NodeId),
            "SourceName": ua.Variant(event.source, _Type.String),
            "Time": ua.Variant(self._clock.utc(event.monotonic_ns), _Type.DateTime),
            "ReceiveTime": ua.Variant(datetime.now(UTC), _Type.DateTime),
            "LocalTime": ua.Variant(ua.TimeZoneDataType(), _Type.ExtensionObject),
            "Message": ua.Variant(ua.LocalizedText(message), _Type.LocalizedText),
            "Severity": ua.Variant(max(1, min(1000, event.severity)), _Type.UInt16),
            "Kind": ua.Variant(event.kind.value, _Type.String),
            "MonotonicTime_ns": ua.Variant(event.monotonic_ns, _Type.Int64),
            "Suppressed": ua.Variant(suppressed, _Type.UInt32),
        }


class _Limit:
    """How many events of one kind this second has seen."""

    def __init__(self, limit: int) -> None:
        self._limit = limit
        self._window_s = float("-inf")
        self._sent = 0
        self.suppressed = 0
        self.last: Event | None = None

    def admits(self, now_s: float, event: Event) -> bool:
        if now_s - self._window_s >= _WINDOW_S:
            self._window_s, self._sent = now_s, 0
        if self._sent < self._limit:
            self._sent += 1
            return True
        self.suppressed += 1
        self.last = event
        return False

    def take_suppressed(self) -> int:
        suppressed, self.suppressed = self.suppressed, 0
        return suppressed


def _add_types(builder: AddressSpaceBuilder) -> dict[EventKind, ua.NodeId]:
    kinds = ua.ObjectIds
    base = builder.event_type(
        f"types.{BASE_TYPE}",
        BASE_TYPE,
        ua.NodeId(kinds.BaseEventType),
        (("Kind", kinds.String, ""), ("MonotonicTime_ns", kinds.Int64, 0), ("Suppressed", 7, 0)),
    )
    types = {
        kind: builder.event_type(f"types.{name}", name, base, ())
        for kind, name in TYPE_NAMES.items()
    }
    for type_id in types.values():
        builder.reference(builder.robot, type_id, kinds.GeneratesEvent, ua.NodeClass.ObjectType)
    return types
