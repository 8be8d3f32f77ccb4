"""asyncua's inner server with our sessions, subscriptions and limits."""

from typing import Any

from asyncua import ua

from hilserver.opcua.access import Access
from hilserver.opcua.application import Application
from hilserver.opcua.browsing import TypeTree
from hilserver.opcua.decoding import bound_decoder
from hilserver.opcua.logs import log
from hilserver.opcua.places import SessionPlaces
from hilserver.opcua.reading import Reader
from hilserver.opcua.sessions import Session
from hilserver.opcua.settings import OpcUaSettings
from hilserver.opcua.spawning import Running, Spawn, spawn_plainly
from hilserver.opcua.standard_nodes import QuickInternalServer
from hilserver.opcua.subscriptions import Subscriptions
from hilserver.opcua.trust_list import TrustList

_LONGEST_SESSION_MS = 120_000.0


class InnerServer(QuickInternalServer):
    """asyncua's inner server with our sessions, subscriptions and limits."""

    def __init__(
        self,
        settings: OpcUaSettings,
        trust: TrustList | None,
        spawn: Spawn = spawn_plainly,
    ) -> None:
        self.spawn = spawn
        self._clock: Running | None = None
        bound_decoder()
        super().__init__(user_manager=None)
        self.disabled_clock = True  # asyncua's task, which nothing would begin again
        self.settings = settings
        self.trust = trust
        self.access = access = Access(settings)
        # may be replaced before the first client
        self.application = Application(self, access)
        self._places = SessionPlaces(
            settings.max_sessions,
            lambda user: self.application.has_reserve(user),  # noqa: PLW0108 - it may be replaced
        )
        self.allow_remote_admin = False
        self.max_connections = settings.max_connections
        # A client that has vanished is served until its session ends.
        self.max_session_timeout_ms = _LONGEST_SESSION_MS
        self.types = TypeTree(self.aspace)
        self.subscription_service = Subscriptions(self.aspace, self.types, settings)
        # asyncua's event generators send through the server's own session, which was made before.
        self.isession.subscription_service.trigger_event = (
            self.subscription_service.trigger_event
        )
        self.reader = Reader(self)
        self.sessions: dict[ua.NodeId, Session] = {}
        if access.admits_anonymous:
            tokens: list[type] = [ua.AnonymousIdentityToken]
        else:
            tokens = []
        if access.has_users:
            tokens.append(ua.UserNameIdentityToken)
        self.supported_tokens = tuple(tokens)

    def new_session(self, processor: Any, policy: Any, name: str | None) -> Session:
        """Return a new session of that name; BadTooManySessions if there is no place for it."""
        visitor = self.application.visitor(name or "", processor.address)
        if not visitor.has_own_place:
            self._places.create(tuple(self.sessions.values()), processor.address)
        session = Session(self, processor, policy, visitor)
        self.sessions[session.auth_token] = session
        return session

    def admit(self, session: Session, user: Any) -> None:
        """Raise BadTooManySessions if there is no place for a session of that user."""
        self._places.activate(tuple(self.sessions.values()), session, user)

    def end_idle_sessions(self, now_s: float) -> None:
        """End sessions whose clients were silent for longer than agreed."""
        for session in tuple(self.sessions.values()):
            if now_s - session.last_active_s > session.timeout_s:
                log.info("opcua session ended: idle", timeout_s=session.timeout_s)
                session.close()

    async def start(self) -> None:
        """Start, with the clock in a task of ours."""
        await super().start()
        self._clock = self.spawn(
            self._set_current_time_loop, "opcua clock", lasting=True
        )

    async def stop(self) -> None:
        """Stop at once: end sessions that outlived their connection, and the clock."""
        for session in tuple(self.sessions.values()):
            session.close()
        for subscription in tuple(self.subscription_service.subscriptions.values()):
            self.subscription_service.remove(subscription)
        if self._clock is not None:
            await self._clock.end()
        await super().stop()
