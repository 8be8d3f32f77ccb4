"""Limits on what one client can ask of the server, and the seams of asyncua that they hang on.

The hardening against hostile clients (certificates, roles, malformed messages) builds on these
classes: sessions, subscriptions and the transport are ours from here on.
"""

import asyncio
import time
from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import InternalSession, SessionState
from asyncua.server.monitored_item_service import MonitoredItemService, MonitoredItemValues
from asyncua.server.subscription_service import SubscriptionService

from hilserver.config.server import OpcUaConfig
from hilserver.io.opcua_server.access import Access
from hilserver.io.opcua_server.door import WriteDoor
from hilserver.io.opcua_server.methods import Methods

_ACTIVATION_WITHIN_S = 10.0
_UNACKNOWLEDGED_MESSAGES = 100
_LONGEST_SESSION_MS = 120_000.0


class GuardedMonitoredItems(MonitoredItemService):  # type: ignore[misc]
    """Monitored items with a bounded queue, whose dead band copes with values without a number."""

    def _modify_monitored_item(self, params: Any) -> ua.MonitoredItemModifyResult:
        if params.MonitoredItemId not in self._monitored_items:
            unknown = ua.StatusCode(ua.StatusCodes.BadMonitoredItemIdInvalid)
            return ua.MonitoredItemModifyResult(StatusCode=unknown)
        asked = params.RequestedParameters
        # asyncua takes 0 for "no limit" here.
        asked.QueueSize = self._revise_queue_size(asked.QueueSize)
        asked.SamplingInterval = self.isub.data.RevisedPublishingInterval
        return super()._modify_monitored_item(params)

    def _is_deadband_exceeded(self, values: MonitoredItemValues, flt: Any) -> bool:
        old, new = values.get_old_datavalue(), values.get_current_datavalue()
        numbers = [dv.Value.Value for dv in (old, new) if dv is not None and dv.Value is not None]
        if len(numbers) < 2 or not all(isinstance(number, int | float) for number in numbers):
            return True
        if old.StatusCode != new.StatusCode:
            return True
        return bool(super()._is_deadband_exceeded(values, flt))


class GuardedSubscriptions(SubscriptionService):  # type: ignore[misc]
    """Subscriptions with a shortest publishing interval.

    asyncua publishes from within a write when the interval is 0, and costs a core when it is tiny;
    with a lower bound a notification only appends to a queue.
    """

    def __init__(self, iserver: InternalServer, min_publishing_ms: float) -> None:
        super().__init__(iserver.aspace, iserver=iserver)
        self._min_publishing_ms = min_publishing_ms

    async def create_subscription(
        self, params: ua.CreateSubscriptionParameters, *args: Any, **more: Any
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription; the publishing interval is revised upwards if need be."""
        asked_ms = params.RequestedPublishingInterval
        # `not >=` also catches NaN.
        if not asked_ms >= self._min_publishing_ms:
            params.RequestedPublishingInterval = self._min_publishing_ms
        result = await super().create_subscription(params, *args, **more)
        subscription = self.subscriptions[result.SubscriptionId]
        subscription.monitored_item_srv = GuardedMonitoredItems(subscription, self.aspace)
        return result


class RobotSession(InternalSession):  # type: ignore[misc]
    """A client's session: its writes go through the door, its calls to our methods.

    Attributes
    ----------
    texts : sequence of str
        Why the operations of the last Write or Call were refused, empty where they were not.
    """

    def __init__(self, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.texts: Sequence[str] = ()

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Answer the Write service."""
        answers = self.iserver.door.write(params.NodesToWrite or [], self.user)
        self.texts = [answer.text for answer in answers]
        return [ua.StatusCode(answer.code) for answer in answers]

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Answer the Call service."""
        results: list[ua.CallMethodResult] = []
        texts: list[str] = []
        for request in params or []:
            if request.MethodId in self.iserver.methods:
                result, text = await self.iserver.methods.call(request, self.user)
            else:
                (result,), text = await self.iserver.method_service.call([request]), ""
            results.append(result)
            texts.append(text)
        self.texts = texts
        return results


class RobotInternalServer(InternalServer):  # type: ignore[misc]
    """asyncua's inner server with our sessions, subscriptions and limits.

    Attributes
    ----------
    door, methods : WriteDoor, Methods
        Set before the first client connects.
    """

    door: WriteDoor
    methods: Methods
    time_task: Any

    def __init__(self, config: OpcUaConfig, access: Access) -> None:
        super().__init__(user_manager=access)
        self._max_sessions = config.max_sessions
        self.allow_remote_admin = False
        self.max_connections = config.max_connections
        self.max_subscriptions = config.max_subscriptions
        self.max_monitored_item_queue_size = config.max_queue_size
        self.max_unacked_messages_per_subscription = _UNACKNOWLEDGED_MESSAGES
        # A client that vanished is served until its session ends.
        self.max_session_timeout_ms = _LONGEST_SESSION_MS
        self.subscription_service = GuardedSubscriptions(self, config.min_publishing_ms)
        self.isession.subscription_service = self.subscription_service
        self.supported_tokens = (ua.AnonymousIdentityToken,)

    def create_session(self, name: str, user: Any = None, external: bool = False) -> Any:
        """Return a new session; BadTooManySessions beyond the limit."""
        sessions = self._external_sessions
        if len(sessions) >= self._max_sessions:
            self._drop_abandoned_sessions()
        if len(sessions) >= self._max_sessions:
            raise ServiceError(ua.StatusCodes.BadTooManySessions)
        arguments = {} if user is None else {"user": user}
        return RobotSession(
            self, self.aspace, self.subscription_service, name, external=external, **arguments
        )

    def register_server(self, server: Any, conf: Any = None) -> None:  # noqa: ARG002
        """Refuse: this is no discovery server."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    def _drop_abandoned_sessions(self) -> None:
        """Forget sessions that were created and never activated: a client may make any number."""
        latest_s = time.monotonic() - _ACTIVATION_WITHIN_S
        for token, session in tuple(self._external_sessions.items()):
            if session.state is SessionState.Created and session._last_activity < latest_s:
                del self._external_sessions[token]

    async def stop(self) -> None:
        """Stop at once: end sessions that outlived their connection, and the clock."""
        for session in tuple(self._external_sessions.values()):
            await session.close_session(True)
        if self.time_task is not None:
            self.time_task.cancel()
            await asyncio.gather(self.time_task, return_exceptions=True)
            self.time_task = None
        await super().stop()
