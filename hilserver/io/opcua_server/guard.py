"""asyncua's inner server with our sessions, subscriptions and limits."""

import asyncio
import time
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.server.internal_server import InternalServer
from asyncua.server.internal_session import SessionState

from hilserver.config.server import OpcUaConfig
from hilserver.io.opcua_security.trust_list import TrustList
from hilserver.io.opcua_server.access import Access
from hilserver.io.opcua_server.decoding import bound_decoder
from hilserver.io.opcua_server.door import WriteDoor
from hilserver.io.opcua_server.methods import Methods
from hilserver.io.opcua_server.sessions import RobotSession
from hilserver.io.opcua_server.subscriptions import RobotSubscriptions

_ACTIVATION_WITHIN_S = 10.0
_UNACKNOWLEDGED_MESSAGES = 100
_LONGEST_SESSION_MS = 120_000.0
_LIMITS = ua.ObjectIds
_OPERATION_LIMITS = (
    _LIMITS.Server_ServerCapabilities_OperationLimits_MaxNodesPerRead,
    _LIMITS.Server_ServerCapabilities_OperationLimits_MaxNodesPerWrite,
    _LIMITS.Server_ServerCapabilities_OperationLimits_MaxNodesPerMethodCall,
    _LIMITS.Server_ServerCapabilities_OperationLimits_MaxNodesPerBrowse,
    _LIMITS.Server_ServerCapabilities_OperationLimits_MaxNodesPerRegisterNodes,
    _LIMITS.Server_ServerCapabilities_OperationLimits_MaxNodesPerTranslateBrowsePathsToNodeIds,
    _LIMITS.Server_ServerCapabilities_OperationLimits_MaxMonitoredItemsPerCall,
)


class RobotInternalServer(InternalServer):  # type: ignore[misc]
    """asyncua's inner server with our sessions, subscriptions and limits.

    Attributes
    ----------
    door, methods : WriteDoor, Methods
        Set before the first client connects.
    trust : TrustList or None
        Judges certificates; None where only policy None is offered.
    """

    door: WriteDoor
    methods: Methods
    time_task: Any

    def __init__(self, config: OpcUaConfig, access: Access, trust: TrustList | None) -> None:
        bound_decoder()
        super().__init__(user_manager=None)
        self.config, self.access, self.trust = config, access, trust
        self._max_sessions = config.max_sessions
        self.allow_remote_admin = False
        self.max_connections = config.max_connections
        self.max_subscriptions = config.max_subscriptions
        self.max_unacked_messages_per_subscription = _UNACKNOWLEDGED_MESSAGES
        # A client that vanished is served until its session ends.
        self.max_session_timeout_ms = _LONGEST_SESSION_MS
        self.subscription_service = RobotSubscriptions(self, config)
        self.isession.subscription_service = self.subscription_service
        tokens: list[type] = [ua.AnonymousIdentityToken] if access.admits_anonymous else []
        if access.has_users:
            tokens.append(ua.UserNameIdentityToken)
        self.supported_tokens = tuple(tokens)

    async def tell_limits(self) -> None:
        """Show the limits where clients look for them, below ServerCapabilities."""
        value = ua.Variant(self.config.max_operations, ua.VariantType.UInt32)
        for node_id in _OPERATION_LIMITS:
            await self.write_attribute_value(ua.NodeId(node_id), ua.DataValue(value))

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
