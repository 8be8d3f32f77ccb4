"""Monitored items: sampled at the agreed interval, filtered, queued within bounds.

Nothing is pushed: an item looks at its place and takes the value if it differs from the last one.
With a sampling interval of 0 it looks after every publish slice, with a longer one when that has
passed, and always in a turn of its subscription.
"""

import functools
import time
from collections.abc import Callable, Iterator
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.opcua.browsing import TypeTree
from hilserver.opcua.deadband import ChangeFilter, change_filter
from hilserver.opcua.items import HANDLE, EventItem, FixedEvent, Item, Room, ValueItem
from hilserver.opcua.reading import find, place_for_items, value_at
from hilserver.opcua.rotation import Portions
from hilserver.opcua.settings import OpcUaSettings
from hilserver.opcua.where import compile_where

LONGEST_SAMPLING_MS = 3_600_000.0
_Codes = ua.StatusCodes
_Modes = ua.MonitoringMode
_Attributes = ua.AttributeIds
_REPORTING = _Modes.Reporting
MAX_SELECTED = 500  # select clauses of an event item
MAX_LINKS = 1000  # between triggering and triggered items, in one subscription
GIVE_WAY_EVERY = 50  # items that are sampled without a pause


class MonitoredItems:
    """The monitored items of one subscription."""

    def __init__(
        self,
        address_space: Any,
        types: TypeTree,
        settings: OpcUaSettings,
        publishing_ms: Callable[[], float],
    ) -> None:
        self._address_space = address_space
        self._types = types
        self._publishing_ms = publishing_ms
        self._longest_queue = settings.max_queue_size
        self._shortest_ms = settings.min_publishing_ms
        self._number = 0
        self._values: dict[int, ValueItem] = {}
        self._events: dict[int, EventItem] = {}
        self._has_links = False
        self.ready: dict[int, Item] = {}  # items with something to send

    def __len__(self) -> int:
        return len(self._values) + len(self._events)

    def _items(self) -> Iterator[Item]:
        yield from self._values.values()
        yield from self._events.values()

    @property
    def queued_values(self) -> int:
        """Total size of all queues, not counting one value each."""
        return sum(item.size - 1 for item in self._items())

    def get(self, item_id: int) -> Item | None:
        """Return an item."""
        return self._values.get(item_id) or self._events.get(item_id)

    def handles(self) -> list[tuple[int, int]]:
        """Return item ids with their client handles."""
        return [(item.item_id, HANDLE.unpack(item.handle)[0]) for item in self._items()]

    # --- services ---------------------------------------------------------------------------------

    def create(
        self, request: ua.MonitoredItemCreateRequest, stamps: int, room: Room
    ) -> ua.MonitoredItemCreateResult:
        """Create an item, if there is room."""
        if room.items <= 0:
            raise ServiceError(_Codes.BadTooManyMonitoredItems)
        if not isinstance(request.MonitoringMode, _Modes):
            raise ServiceError(_Codes.BadMonitoringModeInvalid)
        make: Callable[[Any, Any, Room], Item] = self._make_value
        if request.ItemToMonitor.AttributeId == _Attributes.EventNotifier:
            make = self._make_events
        self._number += 1
        item = make(request, stamps, room)
        self._rearrange()
        result = ua.MonitoredItemCreateResult(
            MonitoredItemId=item.item_id,
            RevisedQueueSize=item.size,
            RevisedSamplingInterval=0.0,
        )
        if isinstance(item, ValueItem):
            result.RevisedSamplingInterval = item.interval_s * 1e3
            if item.mode != _Modes.Disabled:
                self._look_at([item], time.monotonic())
        return result

    def _make_value(self, request: Any, stamps: Any, room: Room) -> Item:
        read = request.ItemToMonitor
        asked = request.RequestedParameters
        place = place_for_items(self._address_space, read)
        change = self._change_filter(read, asked.Filter)
        self._values[self._number] = item = ValueItem(
            item_id=self._number,
            handle=HANDLE.pack(asked.ClientHandle),
            mode=request.MonitoringMode,
            size=room.take(asked.QueueSize, self._longest_queue),
            discard_oldest=asked.DiscardOldest,
            read=read,
            place=place,
            stamps=stamps,
            change=change,
            interval_s=self._revise_sampling(asked.SamplingInterval) / 1e3,
        )
        return item

    def _make_events(self, request: Any, _stamps: Any, room: Room) -> Item:
        read = request.ItemToMonitor
        asked = request.RequestedParameters
        place = find(self._address_space, read.NodeId, read.AttributeId)
        notifier = value_at(place, read.NodeId, read.AttributeId).Value
        if (
            notifier is None
            or not (notifier.Value or 0) & ua.EventNotifier.SubscribeToEvents.mask
        ):
            raise ServiceError(_Codes.BadAttributeIdInvalid)
        wanted = check_event_filter(asked.Filter)
        where = compile_where(wanted.WhereClause, self._types)
        self._events[self._number] = item = EventItem(
            item_id=self._number,
            handle=HANDLE.pack(asked.ClientHandle),
            mode=request.MonitoringMode,
            size=room.take(asked.QueueSize or self._longest_queue, self._longest_queue),
            discard_oldest=asked.DiscardOldest,
            node_id=read.NodeId,
            filter=wanted,
            where=where,
        )
        return item

    def modify(
        self, request: ua.MonitoredItemModifyRequest, stamps: int, room: Room
    ) -> ua.MonitoredItemModifyResult:
        """Change an item."""
        item = self._known(request.MonitoredItemId)
        asked = request.RequestedParameters
        result = ua.MonitoredItemModifyResult()
        if isinstance(item, ValueItem):
            item.change = self._change_filter(item.read, asked.Filter)
            item.interval_s = self._revise_sampling(asked.SamplingInterval) / 1e3
            item.due_s = 0.0
            item.stamps = stamps
            result.RevisedSamplingInterval = item.interval_s * 1e3
        else:
            wanted = check_event_filter(asked.Filter)
            item.where = compile_where(wanted.WhereClause, self._types)
            item.filter = wanted
        item.handle = HANDLE.pack(asked.ClientHandle)
        item.discard_oldest = asked.DiscardOldest
        room.items += 1
        room.queued_values += item.size - 1
        item.size = result.RevisedQueueSize = room.take(
            asked.QueueSize, self._longest_queue
        )
        while len(item.queue) > item.size:
            item.queue.popleft()
        self._rearrange()
        return result

    def delete(self, item_id: int) -> None:
        """Delete an item."""
        self._known(item_id)
        self._values.pop(item_id, None)
        self._events.pop(item_id, None)
        self.ready.pop(item_id, None)
        if self._has_links:
            for other in self._items():
                other.triggers.pop(item_id, None)
        self._rearrange()

    def set_mode(self, item_id: int, mode: ua.MonitoringMode) -> None:
        """Switch an item on or off."""
        item = self._known(item_id)
        was = item.mode
        item.mode = mode
        self.ready.pop(item_id, None)
        self._rearrange()
        if _Modes.Disabled in (was, mode):
            # also when switched on: sampling under way may have taken a value
            item.forget()
        if isinstance(item, ValueItem) and was == _Modes.Disabled != mode:
            self._look_at([item], time.monotonic())
        else:
            self._note(item)

    def trigger(
        self, item_id: int, add: list[int], remove: list[int]
    ) -> tuple[list[int], list[int]]:
        """Link items to one whose notifications let theirs through (SetTriggering)."""
        item = self._known(item_id)
        removed = [
            int(_Codes.Good if item.triggers.pop(number, 0) is None else _unknown)
            for number in remove
        ]
        added = []
        n_links = sum(len(other.triggers) for other in self._items()) if add else 0
        for number in add:
            if self.get(number) is None:
                added.append(_unknown)
            elif n_links + len(added) >= MAX_LINKS:
                added.append(int(_Codes.BadResourceUnavailable))
            else:
                item.triggers[number] = None
                self._has_links = True
                added.append(int(_Codes.Good))
        return added, removed

    def _known(self, item_id: int) -> Item:
        item = self.get(item_id)
        if item is None:
            raise ServiceError(_unknown)
        return item

    # --- sampling ---------------------------------------------------------------------------------

    def after_frame(self, now_s: float) -> Portions:
        """Sample the items that queue every change."""
        return self._in_portions(self._each_frame, now_s)

    def before_publishing(self, now_s: float) -> Portions:
        """Sample all items that are due, or due nearer to this publishing than to the next."""
        return self._in_portions(self._all, now_s, self._publishing_ms() / 2e3)

    def _in_portions(
        self, items: list[ValueItem], now_s: float, slack_s: float = 0.0
    ) -> Portions:
        """Sample items as listed at the start; all at once if one may trigger others."""
        size = max(1, len(items)) if self._has_links else GIVE_WAY_EVERY
        for first in range(0, len(items), size):
            self._look_at(items[first : first + size], now_s, slack_s)
            yield

    @property
    def has_each_frame(self) -> bool:
        """Whether any item is sampled after a frame."""
        return bool(self._each_frame)

    @property
    def has_events(self) -> bool:
        """Whether events are monitored."""
        return bool(self._events)

    def take_event(self, event: FixedEvent) -> Portions:
        """Queue an event for the items that monitor its emitting node."""
        for item in tuple(self._events.values()):
            if item.node_id == event.emitting_node and item.take(event):
                self._note(item)
            yield

    def repeat_values(self) -> None:
        """Report all values again, as if the items were new."""
        for item in self._all:
            item.forget()

    def _look_at(
        self, items: list[ValueItem], now_s: float, slack_s: float = 0.0
    ) -> None:
        # All are sampled before any is noted: one may trigger a later one.
        news = [
            item
            for item in items
            if (value := item.place.value) is not item.seen
            and item.sample(value, now_s, slack_s)
        ]
        for item in news:
            self._note(item)

    def _note(self, item: Item) -> None:
        """List an item, and those it triggers, as having something to send."""
        if not item.queue or self.get(item.item_id) is not item:
            return  # deleted while others were sampled
        for number in item.triggers:
            linked = self.get(number)
            if linked is not None and linked.mode == _Modes.Sampling and linked.queue:
                self.ready[number] = linked
        if item.mode is _REPORTING:
            self.ready[item.item_id] = item

    @functools.cached_property
    def _all(self) -> list[ValueItem]:
        return [item for item in self._values.values() if item.mode != _Modes.Disabled]

    @functools.cached_property
    def _each_frame(self) -> list[ValueItem]:
        return [item for item in self._all if item.size > 1]

    def _rearrange(self) -> None:
        """Rebuild both lists at their next use, not at once: a request may change 1000 items."""
        for name in ("_all", "_each_frame"):
            vars(self).pop(name, None)

    # --- revision of requested parameters ---------------------------------------------------------

    def _revise_sampling(self, asked_ms: float) -> float:
        """Return the revised interval: a negative or missing one means the publishing interval."""
        if asked_ms is None or not asked_ms >= 0:
            return float(self._publishing_ms())
        if asked_ms == 0:
            return 0.0
        return min(max(float(asked_ms), self._shortest_ms), LONGEST_SAMPLING_MS)

    def _change_filter(self, item: ua.ReadValueId, asked: Any) -> ChangeFilter:
        node = self._address_space.get(item.NodeId)
        data_type = node.attributes.get(_Attributes.DataType) if node else None
        kind = _built_in(None if data_type is None else data_type.value)
        return change_filter(asked, item.AttributeId, kind, self._eu_range(node))

    def _eu_range(self, node: Any) -> ua.Range | None:
        for reference in node.references if node else ():
            if reference.IsForward and reference.BrowseName == ua.QualifiedName(
                "EURange", 0
            ):
                place = (
                    self._address_space[reference.NodeId]
                    .attributes[_Attributes.Value]
                    .value
                )
                found = place.Value.Value if place is not None and place.Value else None
                return found if isinstance(found, ua.Range) else None
        return None


_unknown = int(_Codes.BadMonitoredItemIdInvalid)


def check_event_filter(asked: Any) -> ua.EventFilter:
    """Return the filter of an event item; ServiceError if it selects nothing."""
    if not isinstance(asked, ua.EventFilter) or not asked.SelectClauses:
        raise ServiceError(_Codes.BadEventFilterInvalid)
    if len(asked.SelectClauses) > MAX_SELECTED:
        raise ServiceError(_Codes.BadEventFilterInvalid)
    return asked


def _built_in(data_type: ua.DataValue | None) -> ua.VariantType | None:
    if data_type is not None and data_type.Value:
        node_id = data_type.Value.Value
    else:
        node_id = None
    if not isinstance(node_id, ua.NodeId) or node_id.NamespaceIndex != 0:
        return None
    try:
        return ua.VariantType(node_id.Identifier)
    except ValueError:
        return None
