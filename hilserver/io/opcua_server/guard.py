"""asyncua's inner server with our sessions, subscriptions and limits."""

import asyncio
import itertools
import secrets
from collections.abc import Callable
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError

from hilserver.config.server import OpcUaConfig
from hilserver.core.leases import TELEOP
from hilserver.core.standard_nodes import QuickInternalServer
from hilserver.io.opcua_security.trust_list import TrustList
from hilserver.io.opcua_server.access import Access
from hilserver.io.opcua_server.decoding import bound_decoder
from hilserver.io.opcua_server.door import SOURCE, WriteDoor
from hilserver.io.opcua_server.logs import log
from hilserver.io.opcua_server.methods import Methods
from hilserver.io.opcua_server.model import SHELL
from hilserver.io.opcua_server.places import Places
from hilserver.io.opcua_server.reading import Reader
from hilserver.io.opcua_server.sessions import RobotSession
from hilserver.io.opcua_server.subscriptions import Subscriptions
from hilserver.io.opcua_server.type_tree import TypeTree

_LONGEST_SESSION_MS = 120_000.0


class RobotInternalServer(QuickInternalServer):
    """asyncua's inner server with our sessions, subscriptions and limits.

    Attributes
    ----------
    door, methods : WriteDoor, Methods
        Set before the first client connects.
    page_secret : str
        Marks sessions of the operator page, as the first word of their session name.
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
        self._places = Places(config.max_sessions, lambda user: access.may_call(user, "Stop"))
        self.page_secret = secrets.token_hex(32)
        self._page_numbers = itertools.count(1)
        self.allow_remote_admin = False
        self.max_connections = config.max_connections
        # A client that vanished is served until its session ends.
        self.max_session_timeout_ms = _LONGEST_SESSION_MS
        self.types = TypeTree(self.aspace)
        self.subscription_service = Subscriptions(self.aspace, self.types, config)
        self.reader = Reader(self.aspace, access)
        self.sessions: dict[ua.NodeId, RobotSession] = {}
        self.left: Callable[[object], None] = lambda _session: None
        tokens: list[type] = [ua.AnonymousIdentityToken] if access.admits_anonymous else []
        if access.has_users:
            tokens.append(ua.UserNameIdentityToken)
        self.supported_tokens = tuple(tokens)

    def source_of(self, session_name: str | None) -> str:
        """Return under which name a session writes; one that knows the secret is the page's.

        A teleoperation names itself: all it gains is the dead-man.
        """
        if self._is_page(session_name):
            return f"page:{next(self._page_numbers)}"
        return TELEOP if (session_name or "").split(" ")[0] == "teleop" else SOURCE

    def visitor_of(self, session_name: str | None, address: str) -> str:
        """Return where its user sits; the page names that as the second word, itself being here."""
        return (session_name or "").split(" ")[1] if self._is_page(session_name) else address

    def _is_page(self, session_name: str | None) -> bool:
        given = (session_name or "").split(" ")[0]
        return secrets.compare_digest(given.encode(), self.page_secret.encode())

    def new_session(self, processor: Any, policy: Any, name: str | None) -> RobotSession:
        """Return a new session of that name; BadTooManySessions where there is no place for it."""
        is_page = self._is_page(name)
        if not is_page:
            self._places.create(tuple(self.sessions.values()), processor.address)
        session = RobotSession(self, processor, policy)
        session.is_page, session.source = is_page, self.source_of(name)
        session.may_hold_control = (name or "").split(" ")[0] != SHELL
        session.visitor = self.visitor_of(name, processor.address)
        self.sessions[session.auth_token] = session
        return session

    def admit(self, session: RobotSession, user: Any) -> None:
        """Raise BadTooManySessions where there is no place for a session of that user."""
        self._places.activate(tuple(self.sessions.values()), session, user)

    def session_of(self, token: ua.NodeId) -> RobotSession | None:
        """Return the session that an authentication token names."""
        return self.sessions.get(token)

    def forget_session(self, session: RobotSession) -> None:
        """Strike a session that has ended off the list."""
        self.sessions.pop(session.auth_token, None)

    def end_idle_sessions(self, now_s: float) -> None:
        """End sessions whose clients were silent for longer than agreed."""
        for session in tuple(self.sessions.values()):
            if session.is_over(now_s):
                log.info("opcua session ended: idle", timeout_s=session.timeout_s)
                session.close()

    def register_server(self, server: Any, conf: Any = None) -> None:  # noqa: ARG002
        """Refuse: this is no discovery server."""
        raise ServiceError(ua.StatusCodes.BadServiceUnsupported)

    async def stop(self) -> None:
        """Stop at once: end sessions that outlived their connection, and the clock."""
        for session in tuple(self.sessions.values()):
            session.close()
        for subscription in tuple(self.subscription_service.subscriptions.values()):
            self.subscription_service.remove(subscription)
        if self.time_task is not None:
            self.time_task.cancel()
            await asyncio.gather(self.time_task, return_exceptions=True)
            self.time_task = None
        await super().stop()
