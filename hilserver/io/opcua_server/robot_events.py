"""Events of the daemon as OPC UA events: own types, on the Server object and on the robot.

At most `max_events_per_s` events of one kind are sent in a second. Suppressed ones are counted;
the count is sent with the next event of that kind (property Suppressed), at the latest with a
summary when the flood is over.
"""

import time
import uuid
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from asyncua import ua

from hilserver.core.clock import UtcClock
from hilserver.core.events import Event, EventBus, EventKind
from hilserver.io.opcua_server.address_space import SERVER, AddressSpaceBuilder
from hilserver.opcua.items import FixedEvent

BASE_TYPE = "RobotEventType"
TYPE_NAMES: dict[EventKind, str] = {
    EventKind.OVERRUN: "OverrunEventType",
    EventKind.PEER_LOST: "PeerLostEventType",
    EventKind.PEER_RESTORED: "PeerRestoredEventType",
    EventKind.PEER_FAULT: "PeerFaultEventType",
    EventKind.SETPOINT_REFUSED: "SetPointRefusedEventType",
    EventKind.SAFE_STATE: "SafeStateEventType",
    EventKind.MODEL_GAP: "ModelGapEventType",
    EventKind.RECALIBRATION: "RecalibrationEventType",
    EventKind.STATE: "StateChangedEventType",
}
_WINDOW_S = 1.0
_Type = ua.VariantType


class FloodGate:
    """Passes a limited number of events of each kind in a second, and counts the others.

    `emit` gets an event and the number of its kind suppressed since the last one.
    """

    def __init__(
        self,
        limit_per_s: int,
        emit: Callable[[Event, int], None],
        monotonic_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._limit = limit_per_s
        self._emit = emit
        self._monotonic_s = monotonic_s
        self._kinds = {kind: _Window() for kind in EventKind}

    def send(self, event: Event) -> None:
        """Send an event, or count it if there were too many of its kind."""
        window = self._kinds[event.kind]
        if self._has_room(window):
            self._emit(event, window.take_left_out())
        else:
            window.left_out += 1
            window.last = event

    def flush(self) -> None:
        """Send a summary of suppressed events, once their kind has become quiet."""
        for window in self._kinds.values():
            if window.left_out and window.last is not None and self._has_room(window):
                # The summary repeats an event that is itself a suppressed one.
                self._emit(window.last, window.take_left_out() - 1)

    def _has_room(self, window: "_Window") -> bool:
        """Whether one more event may be sent now; if so, it counts as sent."""
        now_s = self._monotonic_s()
        if now_s - window.started_s >= _WINDOW_S:
            window.started_s = now_s
            window.sent = 0
        window.sent += 1
        return window.sent <= self._limit


@dataclass(slots=True)
class _Window:
    """What happened to the events of one kind in this second."""

    started_s: float = float("-inf")
    sent: int = 0
    left_out: int = 0
    last: Event | None = None

    def take_left_out(self) -> int:
        left_out = self.left_out
        self.left_out = 0
        return left_out


class RobotEvents:
    """Sends the events of the bus to OPC UA clients."""

    def __init__(
        self,
        builder: AddressSpaceBuilder,
        subscriptions: Any,
        clock: UtcClock,
        *,
        limit_per_s: int,
    ) -> None:
        self._subscriptions = subscriptions
        self._clock = clock
        self._robot = builder.robot
        kinds = ua.ObjectIds
        own_fields = (
            ("Kind", kinds.String, ""),
            ("MonotonicTime_ns", kinds.Int64, 0),
            ("Suppressed", 7, 0),
        )
        base = builder.event_type(
            f"types.{BASE_TYPE}",
            BASE_TYPE,
            ua.NodeId(kinds.BaseEventType),
            own_fields,
        )
        types = {
            kind: builder.event_type(f"types.{name}", name, base, ())
            for kind, name in TYPE_NAMES.items()
        }
        for type_id in types.values():
            builder.reference(
                builder.robot, type_id, kinds.GeneratesEvent, ua.NodeClass.ObjectType
            )
        self._types = types
        self._gate = FloodGate(limit_per_s, self._emit)
        self._unsubscribe: Callable[[], None] | None = None

    def attach(self, bus: EventBus) -> None:
        """Send every later event of `bus`."""
        self._unsubscribe = bus.subscribe(self._gate.send)

    def detach(self) -> None:
        """Stop sending."""
        if self._unsubscribe is not None:
            self._unsubscribe()
            self._unsubscribe = None

    def flush(self) -> None:
        """Send summaries of floods that are over; called from time to time."""
        self._gate.flush()

    def _emit(self, event: Event, suppressed: int) -> None:
        fields = self._fields(event, suppressed)
        for node_id in (SERVER, self._robot):
            self._subscriptions.take_event(FixedEvent(node_id, fields))

    def _fields(self, event: Event, suppressed: int) -> dict[str, ua.Variant]:
        message = event.message + (f" (and {suppressed} more)" if suppressed else "")
        received = ua.Variant(datetime.now(UTC), _Type.DateTime)
        severity = ua.Variant(max(1, min(1000, event.severity)), _Type.UInt16)
        text = ua.Variant(ua.LocalizedText(message), _Type.LocalizedText)
        return {
            "EventId": ua.Variant(uuid.uuid4().bytes, _Type.ByteString),
            "EventType": ua.Variant(self._types[event.kind], _Type.NodeId),
            "SourceNode": ua.Variant(self._robot, _Type.NodeId),
            "SourceName": ua.Variant(event.source, _Type.String),
            "Time": ua.Variant(self._clock.utc(event.monotonic_ns), _Type.DateTime),
            "ReceiveTime": received,
            "LocalTime": ua.Variant(ua.TimeZoneDataType(), _Type.ExtensionObject),
            "Message": text,
            "Severity": severity,
            "Kind": ua.Variant(event.kind.value, _Type.String),
            "MonotonicTime_ns": ua.Variant(event.monotonic_ns, _Type.Int64),
            "Suppressed": ua.Variant(suppressed, _Type.UInt32),
        }
