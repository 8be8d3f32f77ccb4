"""A client's session: it has access to its own objects only.

The authentication token is random, and belongs to the connection and the certificate that the
session was made with. Subscriptions are reached through the session that owns them; Publish
requests wait here until a subscription has something to send.
"""

import math
import secrets
import time
from collections import deque
from typing import Any, NamedTuple

from asyncua import ua
from asyncua.common.utils import Buffer, ServiceError, create_nonce
from asyncua.crypto.permission_rules import User, UserRole
from asyncua.ua.ua_binary import nodeid_to_binary

from hilserver.opcua import encoding
from hilserver.opcua.application import Visitor
from hilserver.opcua.browsing import ContinuationPoints
from hilserver.opcua.subscriptions import Subscription

_TOKEN_BYTES = 32
_LEAST_RESPONSE_BYTES = 8192
_MAX_STATUS_CHANGES = 10
# besides two per subscription, which python-opcua sends at once
_SPARE_PUBLISH_REQUESTS = 10
_Codes = ua.StatusCodes
_numbers = iter(range(1000, 2**31))


class PublishRequest(NamedTuple):
    """A Publish request that waits for something to send."""

    handle: int
    request_id: int
    expires_s: float
    results: bytes


class Session:
    """A client's session."""

    def __init__(
        self, server: Any, processor: Any, policy: Any, visitor: Visitor
    ) -> None:
        self.server = server
        self.user: Any = User(role=UserRole.User)
        # whether a user has logged in, and whether it has not ended
        self.is_activated = False
        self.is_open = True
        self.session_id = ua.NodeId(next(_numbers))
        self.auth_token = ua.NodeId(
            secrets.token_bytes(_TOKEN_BYTES), 0, ua.NodeIdType.ByteString
        )
        self.token_bytes = bytes(nodeid_to_binary(self.auth_token))
        self.nonce = create_nonce(32)
        # why operations of the last Write or Call were refused, empty if accepted
        self.texts: list[str] = []
        self.processor: Any = None  # the connection that the session is bound to
        # the client that created it, as the application classifies it, and its address
        self.visitor = visitor
        self.address = processor.address
        self.timeout_s = math.inf  # idle time after which it ends
        self.max_response_bytes = 0  # longest response that the client accepts, 0: any
        self.last_active_s = time.monotonic()
        self.pages = ContinuationPoints(server.aspace, server.types)
        self._requests: deque[PublishRequest] = deque()
        self._late: dict[Subscription, None] = {}
        self._status_changes: deque[tuple[int, int]] = deque(maxlen=_MAX_STATUS_CHANGES)
        self.bind(processor, policy)

    # --- life -------------------------------------------------------------------------------------

    def bind(self, processor: Any, policy: Any) -> None:
        """Bind the session to a connection and the certificate that opened its channel.

        Requests from another connection are forgotten.
        """
        self.processor = processor
        self._requests.clear()
        self._certificate = policy.peer_certificate
        self._policy_uri = policy.URI

    def lose_connection(self) -> None:
        """Continue without a connection: another may take over the session, but not its control."""
        self.processor = None
        self._requests.clear()
        self.server.application.left(self)
        if not self.is_activated or not self.subscriptions:
            self.close()

    def is_of(self, policy: Any) -> bool:
        """Whether the channel was opened by the client that this session belongs to."""
        return (policy.peer_certificate, policy.URI) == (
            self._certificate,
            self._policy_uri,
        )

    def is_named_by(self, token: ua.NodeId) -> bool:
        """Whether `token` is our authentication token."""
        given = token.Identifier if isinstance(token.Identifier, bytes) else b""
        return self.is_open and secrets.compare_digest(
            given, self.auth_token.Identifier
        )

    @property
    def holder(self) -> tuple[Any, ...]:
        """Key of the holder whose places it counts for."""
        return (self.user.name, self.address, self._certificate)

    @property
    def owner(self) -> tuple[Any, ...]:
        """Key for taking over its subscriptions: the same user of the same program may do so."""
        return (self.user.name, self._certificate, self._policy_uri)

    @property
    def is_known(self) -> bool:
        """Whether the client can be identified: without a certificate all look alike."""
        return bool(self._certificate) or self.user.name is not None

    def create(self, params: ua.CreateSessionParameters) -> ua.CreateSessionResult:
        """Agree on time-out and sizes."""
        asked_ms = params.RequestedSessionTimeout
        shortest = self.server.min_session_timeout_ms
        longest = self.server.max_session_timeout_ms
        # A time-out of NaN would never expire.
        if math.isfinite(asked_ms):
            revised_ms = min(max(asked_ms, shortest), longest)
        else:
            revised_ms = longest
        self.timeout_s = revised_ms / 1e3
        asked = int(params.MaxResponseMessageSize or 0)
        self.max_response_bytes = max(asked, _LEAST_RESPONSE_BYTES) if asked else 0
        return ua.CreateSessionResult(
            SessionId=self.session_id,
            AuthenticationToken=self.auth_token,
            RevisedSessionTimeout=revised_ms,
            ServerNonce=self.nonce,
        )

    def activate(self, user: Any) -> ua.ActivateSessionResult:
        """Admit a user whose identity has been checked."""
        self.user = user
        self.is_activated = True
        self.nonce = create_nonce(32)
        self.touch()
        return ua.ActivateSessionResult(ServerNonce=self.nonce)

    @property
    def is_out_of_time(self) -> bool:
        """Whether the request that is being answered has used up its time."""
        return self.processor is None or self.processor.is_out_of_time

    def touch(self) -> None:
        """Note a sign of life."""
        self.last_active_s = time.monotonic()

    def close(self, delete_subscriptions: bool = True) -> None:
        """End the session."""
        if not self.is_open:
            return
        self.is_open = self.is_activated = False
        del self.server.sessions[self.auth_token]
        self.server.application.left(self)
        while self._requests:
            self._refuse(self._requests.popleft(), _Codes.BadSessionClosed)
        if delete_subscriptions:
            for subscription in self.subscriptions:
                self.server.subscription_service.remove(subscription)
        processor = self.processor
        self.processor = None
        if processor is not None and processor.session is self:
            processor.session = None

    # --- Publish ----------------------------------------------------------------------------------

    @property
    def subscriptions(self) -> list[Subscription]:
        """The session's own subscriptions."""
        return self.server.subscription_service.of(self)  # type: ignore[no-any-return]

    def own(self, subscription_id: int) -> Subscription:
        """Return a subscription of this session; others do not exist for it."""
        found = self.server.subscription_service.subscriptions.get(subscription_id)
        if found is None or found.session is not self:
            raise ServiceError(_Codes.BadSubscriptionIdInvalid)
        return found  # type: ignore[no-any-return]

    def publish(
        self, head: encoding.RequestHead, request_id: int, body: Buffer
    ) -> None:
        """Take a Publish request: process its acknowledgements, and keep it for later."""
        n_own = len(self.subscriptions)
        if not n_own and not self._status_changes:
            raise ServiceError(_Codes.BadNoSubscription)
        received = encoding.acknowledgements(body)
        if len(received) > self.server.settings.max_operations:
            raise ServiceError(_Codes.BadTooManyOperations)
        results = encoding.status_codes([self._acknowledge(*pair) for pair in received])
        now_s = time.monotonic()
        expires_s = now_s + head.timeout_ms / 1e3 if head.timeout_ms else math.inf
        if len(self._requests) >= 2 * n_own + _SPARE_PUBLISH_REQUESTS:
            oldest = self._requests.popleft()
            is_late = oldest.expires_s < now_s
            self._refuse(
                oldest,
                _Codes.BadTimeout if is_late else _Codes.BadTooManyPublishRequests,
            )
        self._requests.append(
            PublishRequest(head.handle, request_id, expires_s, results)
        )
        if self._status_changes:
            self._send_status_change()
        else:
            self._serve_late(1)

    def _acknowledge(self, subscription_id: int, sequence: int) -> int:
        try:
            found = self.own(subscription_id)
        except ServiceError as error:
            return int(error.code)
        known = found.acknowledge(sequence)
        return int(_Codes.Good if known else _Codes.BadSequenceNumberUnknown)

    def take_publish_request(self, subscription: Subscription) -> PublishRequest | None:
        """Return a request to answer; if there is none, the subscription waits for one."""
        now_s = time.monotonic()
        is_reading = self.processor is not None and not self.processor.is_congested
        while is_reading and self._requests:
            request = self._requests.popleft()
            if request.expires_s >= now_s:
                return request
            self._refuse(request, _Codes.BadTimeout)
        self._late[subscription] = None
        return None

    def resume(self) -> None:
        """Continue sending after the client has read earlier answers."""
        self._serve_late(len(self._requests))

    def _serve_late(self, most: int) -> None:
        """Give turns to the subscriptions that have waited longest for a request."""
        for subscription in tuple(self._late)[:most]:
            del self._late[subscription]
            self.server.subscription_service.rotation.add(subscription)

    def answer_publish(
        self,
        request: PublishRequest,
        number: int,
        available: list[int],
        more: bool,
        message: bytes,
    ) -> None:
        """Send the message of a subscription."""
        if self.processor is not None:
            body = encoding.publish_response(
                request.handle, number, available, more, message, request.results
            )
            self.processor.send_body(request.request_id, request.handle, body)

    def forget(self, subscription: Subscription, reason: int) -> None:
        """Release a subscription; notify the client with `reason` if it did not request this."""
        self._late.pop(subscription, None)
        if reason:
            self._status_changes.append((subscription.number, reason))
            if self._requests:
                self._send_status_change()

    def _send_status_change(self) -> None:
        number, reason = self._status_changes.popleft()
        request = self._requests.popleft()
        change = encoding.extension(
            encoding.STATUS_CHANGE, reason.to_bytes(4, "little"), b"\0"
        )
        message = encoding.notification_message(1, [change])
        self.answer_publish(request, number, [], False, message)

    def _refuse(self, request: PublishRequest, code: int) -> None:
        if self.processor is not None:
            self.processor.send_fault(request.request_id, request.handle, code)
