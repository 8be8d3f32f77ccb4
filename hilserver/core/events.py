"""Events: what happened, published once to all subscribers (log, OPC UA, tests)."""

import math
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from enum import StrEnum


class EventKind(StrEnum):
    """Kinds of events; the OPC UA server has one event type for each."""

    OVERRUN = "overrun"
    PEER_LOST = "peer_lost"
    PEER_RESTORED = "peer_restored"
    PEER_FAULT = "peer_fault"
    SETPOINT_REFUSED = "setpoint_refused"
    SAFE_STATE = "safe_state"
    MODEL_GAP = "model_gap"
    RECALIBRATION = "recalibration"
    STATE = "state"


@dataclass(frozen=True, slots=True)
class Event:
    """One event."""

    kind: EventKind
    severity: int  # 1 (information) .. 1000 (catastrophe), OPC UA's scale
    source: str  # its subject: a slice, a peer, a signal
    message: str
    # CLOCK_MONOTONIC at which it was seen
    monotonic_ns: int = field(default_factory=time.monotonic_ns)
    simulated_s: float = math.nan  # simulated time then; the bus knows it


class EventBus:
    """Hands every event to all subscribers; keeps the newest 256, and as many overruns.

    `simulated_s` gives the simulated time [s], which every event gets.
    """

    def __init__(self, simulated_s: Callable[[], float] = lambda: math.nan) -> None:
        self._simulated_s = simulated_s
        self._events: deque[Event] = deque(maxlen=256)
        self._overruns: deque[Event] = deque(maxlen=256)
        self._subscribers: list[Callable[[Event], None]] = []

    @property
    def recent(self) -> list[Event]:
        """The kept events, oldest first; a flood of overruns displaces no others."""
        return sorted(
            (*self._events, *self._overruns), key=lambda event: event.monotonic_ns
        )

    def subscribe(self, callback: Callable[[Event], None]) -> Callable[[], None]:
        """Call `callback` for every later event; return a function that unsubscribes it."""
        self._subscribers.append(callback)

        def unsubscribe() -> None:
            if callback in self._subscribers:
                self._subscribers.remove(callback)

        return unsubscribe

    def publish(self, event: Event) -> None:
        """Hand `event` to every subscriber, in order of subscription."""
        event = replace(event, simulated_s=self._simulated_s())
        (self._overruns if event.kind == EventKind.OVERRUN else self._events).append(
            event
        )
        for callback in tuple(self._subscribers):
            callback(event)
