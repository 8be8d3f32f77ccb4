"""A subscription on the raw services: no task per value, granted intervals read back.

If the peer has no counter, the trigger is status, value *and* time stamp: a controller that
repeats a constant set-point with a new stamp then counts as alive. For servers that do not know
this trigger it is left out; with a counter it is not needed.
"""

import asyncio
import time
from dataclasses import dataclass
from typing import Any

from asyncua import ua

from hilserver.io.opcua_client.session import PeerSession, judge
from hilserver.io.peer_link.intake import FaultyIntake
from hilserver.io.peer_link.samples import LinkLostError

QUEUE_MAX = 1000
SILENT_AFTER_S = 2.0
LIFETIME_MS = 30_000


@dataclass(frozen=True, slots=True)
class Grant:
    """Intervals that the peer granted [ms]; sampling is the slowest of all nodes."""

    publishing_ms: float
    sampling_ms: float


class PeerSubscription:
    """One subscription for all nodes of a peer.

    Parameters
    ----------
    every_stamp : bool
        Also notify new stamps of unchanged values.
    poll_ms : float
        Shortest interval of interest: sizes the queues, and is the requested sampling interval of
        nodes that leave it open (0 on such a node terminates Node-RED).
    """

    def __init__(
        self,
        session: PeerSession,
        intake: FaultyIntake,
        *,
        poll_ms: float,
        every_stamp: bool,
    ) -> None:
        self._session = session
        self._intake = intake
        self._poll_ms = poll_ms
        self._every_stamp = every_stamp
        self._handles: dict[int, str] = {}
        self._received_s = time.monotonic()
        self._silent_after_s = SILENT_AFTER_S
        self._sampling_asked_ms = 0.0
        self._id = 0
        self._failure: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self.grant = Grant(0.0, 0.0)

    async def create(
        self, *, publishing_ms: float, sampling_ms: float, keep_alive_ms: float
    ) -> Grant:
        """Create the subscription without nodes and return what was granted."""
        keep_alives = max(1, int(keep_alive_ms / publishing_ms))
        request = ua.CreateSubscriptionParameters()
        request.RequestedPublishingInterval = publishing_ms
        request.RequestedMaxKeepAliveCount = keep_alives
        request.RequestedLifetimeCount = max(
            10 * keep_alives, int(LIFETIME_MS / publishing_ms)
        )
        request.PublishingEnabled = True
        result = await self._session.services.create_subscription(
            request, self._on_publish
        )
        self._id = result.SubscriptionId
        self._sampling_asked_ms = sampling_ms
        self.grant = Grant(result.RevisedPublishingInterval, 0.0)
        keep_alive_s = (
            result.RevisedPublishingInterval * result.RevisedMaxKeepAliveCount / 1000
        )
        self._silent_after_s = max(SILENT_AFTER_S, 3 * keep_alive_s)
        return self.grant

    async def add(self, nodes: list[str]) -> list[str]:
        """Monitor `nodes`; return those that the peer does not have yet."""
        resolved = await self._session.resolve(nodes)
        now_ns = time.monotonic_ns()
        missing = [node for node in nodes if resolved[node] is None]
        for node in missing:
            self._intake.missing(node, "the peer does not have this namespace", now_ns)
        found = [node for node in nodes if resolved[node] is not None]
        if not found:
            return missing
        fastest = await self._session.read_attributes(
            [resolved[node] for node in found], ua.AttributeIds.MinimumSamplingInterval
        )
        items = [
            self._item(node, resolved[node], minimum)
            for node, minimum in zip(found, fastest, strict=True)
        ]
        results = await self._create_items(items)
        for node, item, result in zip(found, items, results, strict=True):
            if result.StatusCode.is_good():
                sampling_ms = max(
                    self.grant.sampling_ms, result.RevisedSamplingInterval
                )
                self.grant = Grant(self.grant.publishing_ms, sampling_ms)
                continue
            self._handles.pop(item.RequestedParameters.ClientHandle, None)
            self._intake.missing(
                node, f"status {result.StatusCode.name}", time.monotonic_ns()
            )
            missing.append(node)
        return missing

    def _item(
        self, node: str, node_id: ua.NodeId, minimum_ms: float | None
    ) -> ua.MonitoredItemCreateRequest:
        handle = len(self._handles) + 1
        while handle in self._handles:
            handle += 1
        self._handles[handle] = node
        sampling_ms = self._sampling_asked_ms
        if minimum_ms is not None and minimum_ms < 0:
            sampling_ms = max(sampling_ms, self._poll_ms)
        parameters = ua.MonitoringParameters()
        parameters.ClientHandle = handle
        parameters.SamplingInterval = sampling_ms
        parameters.DiscardOldest = True
        samples_per_publish = self.grant.publishing_ms / max(self._poll_ms, 1.0)
        parameters.QueueSize = int(min(QUEUE_MAX, 10 + 4 * samples_per_publish))
        if self._every_stamp:
            trigger = ua.DataChangeTrigger.StatusValueTimestamp
            parameters.Filter = ua.DataChangeFilter(Trigger=trigger)
        item = ua.MonitoredItemCreateRequest()
        item.ItemToMonitor = ua.ReadValueId(
            NodeId=node_id, AttributeId=ua.AttributeIds.Value
        )
        item.MonitoringMode = ua.MonitoringMode.Reporting
        item.RequestedParameters = parameters
        return item

    async def _create_items(
        self, items: list[ua.MonitoredItemCreateRequest]
    ) -> list[Any]:
        request = ua.CreateMonitoredItemsParameters()
        request.SubscriptionId = self._id
        request.TimestampsToReturn = ua.TimestampsToReturn.Source
        request.ItemsToCreate = items
        results = list(await self._session.services.create_monitored_items(request))
        if len(results) != len(items):
            raise LinkLostError(
                "the peer answered a subscription with the wrong number of nodes"
            )
        again = [
            index
            for index, result in enumerate(results)
            if result.StatusCode.value
            in (
                ua.StatusCodes.BadMonitoredItemFilterUnsupported,
                ua.StatusCodes.BadFilterNotAllowed,
            )
        ]
        if again and items[again[0]].RequestedParameters.Filter is not None:
            for index in again:
                items[index].RequestedParameters.Filter = None
            second = await self._create_items([items[index] for index in again])
            for index, result in zip(again, second, strict=True):
                results[index] = result
        return results

    def _on_publish(self, result: ua.PublishResult) -> None:
        # The library swallows exceptions of its callback; the session must end instead.
        try:
            now_ns = time.monotonic_ns()
            self._received_s = now_ns / 1e9
            samples = []
            for notification in result.NotificationMessage.NotificationData or ():
                if isinstance(notification, ua.DataChangeNotification):
                    for item in notification.MonitoredItems:
                        node = self._handles.get(item.ClientHandle)
                        if node is not None:
                            samples.append((node, judge(item.Value)))
            self._intake.receive(samples, now_ns)
        except Exception as error:  # noqa: BLE001
            if not self._failure.done():
                self._failure.set_exception(error)

    async def watch(self, duration_s: float) -> None:
        """Wait; raise the error that occurs meanwhile.

        LinkLostError if even keep-alives are missing for three of their intervals.
        """
        await asyncio.wait({self._failure}, timeout=duration_s)
        if self._failure.done():
            self._failure.result()
        if time.monotonic() - self._received_s > self._silent_after_s:
            raise LinkLostError("the subscription went silent")

    async def delete(self) -> None:
        """Delete the subscription at the peer."""
        await self._session.services.delete_subscriptions([self._id])
