"""Monitored items: sampled as often as was agreed, filtered, queued within bounds.

A sampling interval of 0 reports every change the publish slice writes. A longer one is kept by
sampling and holding: at each sampling instant the value that stood there is compared with the one
reported last.
"""

import math
import time
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.server.monitored_item_service import MonitoredItemData, MonitoredItemService

from hilserver.io.opcua_server.deadband import ChangeFilter, FilterError, change_filter

LONGEST_SAMPLING_MS = 3_600_000.0
_Codes = ua.StatusCodes
_Modes = ua.MonitoringMode
_Attributes = ua.AttributeIds


@dataclass(slots=True)
class _Sampler:
    """State of one monitored value."""

    change: ChangeFilter
    interval_ms: float
    due_s: float = 0.0
    pending: ua.DataValue | None = None
    reported: ua.DataValue | None = None

    def take(self, value: ua.DataValue, now_s: float) -> list[ua.DataValue]:
        """Return what was sampled up to now: the value held before, this one, or neither."""
        if self.interval_ms == 0:
            return [value]
        samples = self.take_held(now_s)
        if now_s >= self.due_s:
            self._step(now_s)
            samples.append(value)
        else:
            self.pending = value
        return samples

    def take_held(self, now_s: float) -> list[ua.DataValue]:
        """Return the value that waits for its sampling instant, once that has passed."""
        if self.pending is None or now_s < self.due_s:
            return []
        held, self.pending = self.pending, None
        self._step(now_s)
        return [held]

    def _step(self, now_s: float) -> None:
        interval_s = self.interval_ms / 1e3
        missed = math.floor((now_s - self.due_s) / interval_s) if self.due_s else 0
        self.due_s = (self.due_s or now_s) + (missed + 1) * interval_s


class RobotMonitoredItems(MonitoredItemService):  # type: ignore[misc]
    """The monitored items of one subscription."""

    def __init__(self, subscription: Any, address_space: Any) -> None:
        super().__init__(subscription, address_space)
        self._samplers: dict[int, _Sampler] = {}

    def __len__(self) -> int:
        return len(self._monitored_items)

    async def create_monitored_items(self, params: Any) -> list[ua.MonitoredItemCreateResult]:
        """Create items, as many as there is room for on this server."""
        results = []
        for item in params.ItemsToCreate:
            code = self._refuse(item)
            if code is not None:
                result = ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(code))
            elif item.ItemToMonitor.AttributeId == _Attributes.EventNotifier:
                result = self._create_events_monitored_item(item)
            else:
                result = await self._create_data_change_monitored_item(item)
            results.append(result)
        return results

    def _refuse(self, item: ua.MonitoredItemCreateRequest) -> int | None:
        if not self.isub.has_room_for_item():
            return int(_Codes.BadTooManyMonitoredItems)
        node = self.aspace.get(item.ItemToMonitor.NodeId)
        if node is None:
            return int(_Codes.BadNodeIdUnknown)
        if item.ItemToMonitor.AttributeId not in node.attributes:
            return int(_Codes.BadAttributeIdInvalid)
        if item.ItemToMonitor.IndexRange:
            return int(_Codes.BadIndexRangeInvalid)
        wanted = item.RequestedParameters.Filter
        if item.ItemToMonitor.AttributeId == _Attributes.EventNotifier and not isinstance(
            wanted, ua.EventFilter
        ):
            return int(_Codes.BadEventFilterInvalid)
        return None

    def _make_monitored_item_common(self, params: Any) -> tuple[Any, MonitoredItemData]:
        result, data = super()._make_monitored_item_common(params)
        data.discard_oldest = params.RequestedParameters.DiscardOldest
        is_event = params.ItemToMonitor.AttributeId == _Attributes.EventNotifier
        if is_event and params.RequestedParameters.QueueSize == 0:
            data.queue_size = result.RevisedQueueSize = self.isub.max_queue_size
        result.RevisedSamplingInterval = 0.0  # events are not sampled
        return result, data

    async def _create_data_change_monitored_item(self, params: Any) -> ua.MonitoredItemCreateResult:
        try:
            change = self._change_filter(params.ItemToMonitor, params.RequestedParameters.Filter)
        except FilterError as error:
            return ua.MonitoredItemCreateResult(StatusCode=ua.StatusCode(error.code))
        interval_ms = self._revise_sampling(params.RequestedParameters.SamplingInterval)
        # asyncua numbers the items and reports the first value from within.
        self._samplers[self._monitored_item_counter + 1] = _Sampler(change, interval_ms)
        result = await super()._create_data_change_monitored_item(params)
        result.RevisedSamplingInterval = interval_ms
        if not result.StatusCode.is_good():
            self._samplers.pop(self._monitored_item_counter, None)
        return result

    def _modify_monitored_item(self, params: Any) -> ua.MonitoredItemModifyResult:
        data = self._monitored_items.get(params.MonitoredItemId)
        if data is None:
            unknown = ua.StatusCode(_Codes.BadMonitoredItemIdInvalid)
            return ua.MonitoredItemModifyResult(StatusCode=unknown)
        asked = params.RequestedParameters
        result = ua.MonitoredItemModifyResult()
        sampler = self._samplers.get(params.MonitoredItemId)
        if sampler is not None:
            try:
                sampler.change = self._change_filter(data.read_value_id, asked.Filter)
            except FilterError as error:
                return ua.MonitoredItemModifyResult(StatusCode=ua.StatusCode(error.code))
            sampler.interval_ms = self._revise_sampling(asked.SamplingInterval)
            result.RevisedSamplingInterval = sampler.interval_ms
        data.client_handle = asked.ClientHandle
        data.discard_oldest = asked.DiscardOldest
        data.queue_size = result.RevisedQueueSize = self._revise_queue_size(asked.QueueSize)
        self.isub.shorten_queue(params.MonitoredItemId, data.queue_size)
        return result

    def _revise_queue_size(self, requested: int) -> int:
        """Return the queue size: 0 means one value (OPC 10000-4, 5.12.1.5), never no limit."""
        return min(max(int(requested), 1), int(self.isub.max_queue_size))

    def _revise_sampling(self, asked_ms: float) -> float:
        """Return the interval that is kept: negative or none means the publishing interval."""
        if asked_ms is None or not asked_ms >= 0:
            return float(self.isub.data.RevisedPublishingInterval)
        return min(float(asked_ms), LONGEST_SAMPLING_MS)

    def _change_filter(self, item: ua.ReadValueId, asked: Any) -> ChangeFilter:
        node = self.aspace.get(item.NodeId)
        data_type = node.attributes.get(_Attributes.DataType) if node else None
        kind = _built_in(None if data_type is None else data_type.value)
        return change_filter(asked, item.AttributeId, kind, self._eu_range(node))

    def _eu_range(self, node: Any) -> ua.Range | None:
        for reference in node.references if node else ():
            if reference.IsForward and reference.BrowseName == ua.QualifiedName("EURange", 0):
                place = self.aspace[reference.NodeId].attributes[_Attributes.Value].value
                found = place.Value.Value if place is not None and place.Value else None
                return found if isinstance(found, ua.Range) else None
        return None

    def _delete_monitored_items(self, mid: int) -> ua.StatusCode:
        self._samplers.pop(mid, None)
        self.isub.shorten_queue(mid, 0)
        return super()._delete_monitored_items(mid)

    async def _set_monitoring_mode(self, mode: ua.MonitoringMode, mid: int) -> ua.StatusCode:
        sampler = self._samplers.get(mid)
        if mode == _Modes.Disabled:
            self.isub.shorten_queue(mid, 0)
            if sampler is not None:
                sampler.pending = sampler.reported = None
        return await super()._set_monitoring_mode(mode, mid)

    def is_reporting(self, mid: int) -> bool:
        """Whether what is queued for an item is to be sent."""
        data = self._monitored_items.get(mid)
        return data is not None and data.mode == _Modes.Reporting

    async def datachange_callback(
        self, handle: int, value: ua.DataValue, error: ua.StatusCode | None = None
    ) -> None:
        """Take a value that the publish slice has written."""
        if error:
            await self.trigger_statuschange(error)
            return
        mid = self._monitored_datachange[handle]
        if self._monitored_items[mid].mode != _Modes.Disabled:
            self._report(mid, self._samplers[mid].take(value, time.monotonic()))

    def sample(self, now_s: float) -> None:
        """Report values held until now; called before each publishing."""
        for mid, sampler in self._samplers.items():
            if sampler.pending is not None:
                self._report(mid, sampler.take_held(now_s))

    def _report(self, mid: int, values: list[ua.DataValue]) -> None:
        sampler, data = self._samplers[mid], self._monitored_items[mid]
        for value in values:
            if sampler.change.is_worth_reporting(sampler.reported, value):
                sampler.reported = value
                self.isub.queue_value(mid, data, value)


def _built_in(data_type: ua.DataValue | None) -> ua.VariantType | None:
    node_id = data_type.Value.Value if data_type is not None and data_type.Value else None
    if not isinstance(node_id, ua.NodeId) or node_id.NamespaceIndex != 0:
        return None
    try:
        return ua.VariantType(node_id.Identifier)
    except ValueError:
        return None
