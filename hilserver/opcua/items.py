"""One monitored item: filters changes and queues them within bounds."""

import math
import struct
from collections import deque
from dataclasses import dataclass, field
from typing import Any, ClassVar

from asyncua import ua
from asyncua.ua.ua_binary import struct_to_binary

from hilserver.opcua.deadband import ChangeFilter
from hilserver.opcua.encoding import DATA_CHANGE, EVENTS, FixedDataValue

HANDLE = struct.Struct("<I")
_NULL = ua.Variant()
# InfoType DataValue and Overflow of a status code (OPC 10000-4, 7.39.1)
_OVERFLOW = 0x480


@dataclass
class Room:
    """How much more a session may monitor."""

    items: int
    queued_values: int

    def take(self, asked: int, longest: int) -> int:
        """Return the queue size granted: 0 means one value, never no limit (5.12.1.5)."""
        size = max(1, min(asked, longest, self.queued_values + 1))
        self.items -= 1
        self.queued_values -= size - 1
        return size


@dataclass(slots=True, eq=False, kw_only=True)
class _Item:
    item_id: int
    handle: bytes
    mode: ua.MonitoringMode
    size: int
    discard_oldest: bool
    queue: deque[Any] = field(default_factory=deque)
    triggers: dict[int, None] = field(default_factory=dict)


@dataclass(slots=True, eq=False, kw_only=True)
class ValueItem(_Item):
    """A monitored attribute."""

    kind: ClassVar[bytes] = DATA_CHANGE
    read: ua.ReadValueId
    place: Any  # that holds the value
    stamps: int
    change: ChangeFilter
    interval_s: float  # sampling interval [s]; 0: every change
    due_s: float = 0.0
    seen: Any = None
    reported: FixedDataValue | None = None

    def sample(self, value: ua.DataValue, now_s: float, slack_s: float = 0.0) -> bool:
        """Take the value of the place if it is due and new; return whether it was queued.

        `slack_s`: it is due so much earlier, at most half its interval, so that an item with the
        publishing interval is sampled in every one of them [s].
        """
        if self.interval_s:
            now_s += min(slack_s, self.interval_s / 2)
            if now_s < self.due_s:
                return False
            if self.due_s:
                missed = math.floor((now_s - self.due_s) / self.interval_s)
            else:
                missed = 0
            self.due_s = (self.due_s or now_s) + (missed + 1) * self.interval_s
        self.seen = value
        fixed = FixedDataValue.of(value)
        if not self.change.is_worth_reporting(self.reported, fixed):
            return False
        self.reported = fixed
        queue = self.queue
        is_full = len(queue) >= self.size
        if is_full:
            queue.popleft() if self.discard_oldest else queue.pop()
        queue.append(fixed)
        if is_full and self.size > 1:
            # A lost value is marked next to the gap.
            end = 0 if self.discard_oldest else -1
            marked = queue[end]
            code = ua.StatusCode(marked.code | _OVERFLOW)
            queue[end] = FixedDataValue(
                marked.Value,
                code,
                marked.SourceTimestamp,
                marked.ServerTimestamp,
            )
        return True

    def forget(self) -> None:
        """Start again: the next value counts as a change."""
        self.queue.clear()
        self.seen = self.reported = None

    def pop(self) -> bytes:
        """Return the oldest notification."""
        value: FixedDataValue = self.queue.popleft()
        return self.handle + value.encoded(self.stamps)


class FixedEvent:
    """An event that does not change after it is made."""

    def __init__(self, emitting_node: ua.NodeId, fields: dict[str, ua.Variant]) -> None:
        self.emitting_node = emitting_node
        self._fields = fields

    def field(self, name: str) -> Any:
        """Return the value of a field, None if it does not exist."""
        return self._fields.get(name, _NULL).Value

    def selected(self, clauses: list[ua.SimpleAttributeOperand]) -> list[ua.Variant]:
        """Return the fields a client selected; null for those that do not exist."""
        names = ("/".join(part.Name or "" for part in c.BrowsePath) for c in clauses)
        return [self._fields.get(name, _NULL) for name in names]


@dataclass(slots=True, eq=False, kw_only=True)
class EventItem(_Item):
    """A monitored source of events."""

    kind: ClassVar[bytes] = EVENTS
    node_id: ua.NodeId
    filter: ua.EventFilter
    where: Any

    def take(self, event: FixedEvent) -> bool:
        """Queue an event that passes the filter; return whether it did."""
        if self.mode == ua.MonitoringMode.Disabled or not self.where(event):
            return False
        fields = ua.EventFieldList(
            EventFields=event.selected(self.filter.SelectClauses)
        )
        if len(self.queue) >= self.size:
            if not self.discard_oldest:
                return False
            self.queue.popleft()
        self.queue.append(bytes(struct_to_binary(fields))[HANDLE.size :])
        return True

    def forget(self) -> None:
        """Drop the queue."""
        self.queue.clear()

    def pop(self) -> bytes:
        """Return the oldest notification."""
        fields: bytes = self.queue.popleft()
        return self.handle + fields


Item = ValueItem | EventItem
