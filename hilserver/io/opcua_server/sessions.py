"""A client's session: what it may touch is its own.

The authentication token is random, and belongs to the connection and the certificate that the
session was made with. Subscriptions are reached through the session that owns them.
"""

import math
import secrets
from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError, create_nonce
from asyncua.server.internal_session import InternalSession, SessionState

from hilserver.io.opcua_server.browsing import ContinuationPoints

_TOKEN_BYTES = 32
_MAX_PATH_ELEMENTS = 50
_Codes = ua.StatusCodes


class RobotSession(InternalSession):  # type: ignore[misc]
    """A client's session: its writes go through the door, its calls to our methods.

    Attributes
    ----------
    texts : sequence of str
        Why the operations of the last Write or Call were refused, empty where they were not.
    processor : RobotProcessor or None
        The connection that the session is bound to.
    """

    state: SessionState

    def __init__(self, *args: Any, external: bool = False, **more: Any) -> None:
        super().__init__(*args, external=False, **more)
        self.external = external
        self.auth_token = ua.NodeId(secrets.token_bytes(_TOKEN_BYTES), 0, ua.NodeIdType.ByteString)
        self.texts: Sequence[str] = ()
        self.processor: Any = None
        self._certificate: bytes | None = None
        self._policy_uri = ""
        self._pages = ContinuationPoints(self.iserver.view_service, self.iserver.aspace)
        if external:
            self.iserver.register_external_session(self)

    # --- life -------------------------------------------------------------------------------------

    def bind(self, processor: Any, policy: Any) -> None:
        """Bind the session to a connection and the certificate that opened its channel."""
        self.processor = processor
        self._certificate, self._policy_uri = policy.peer_certificate, policy.URI

    def is_of(self, policy: Any) -> bool:
        """Whether the channel was opened by the client that this session belongs to."""
        return (policy.peer_certificate, policy.URI) == (self._certificate, self._policy_uri)

    def is_named_by(self, token: ua.NodeId) -> bool:
        """Whether `token` is our authentication token."""
        given = token.Identifier if isinstance(token.Identifier, bytes) else b""
        return secrets.compare_digest(given, self.auth_token.Identifier) and (
            self.state is not SessionState.Closed
        )

    @property
    def owner(self) -> tuple[Any, ...]:
        """Who may take over subscriptions of this session: the same user of the same program."""
        return (self.user.name, self._certificate, self._policy_uri)

    def activate(self, user: Any) -> ua.ActivateSessionResult:
        """Let a user in whose identity has been checked."""
        if self.state is SessionState.Created:
            InternalSession._current_connections += 1  # asyncua's books; closing takes it off
        self.user, self.state = user, SessionState.Activated
        self.nonce = create_nonce(32)
        self.touch()
        self._start_timeout_watchdog()
        return ua.ActivateSessionResult(ServerNonce=self.nonce)

    def _limit(self, items: Sequence[Any] | None) -> Sequence[Any]:
        """Return `items` if a request may have so many."""
        if not items:
            raise ServiceError(_Codes.BadNothingToDo)
        if len(items) > self.iserver.config.max_operations:
            raise ServiceError(_Codes.BadTooManyOperations)
        return items

    async def create_session(
        self, params: ua.CreateSessionParameters, sockname: Any = None
    ) -> ua.CreateSessionResult:
        """Revise the time-out into bounds; NaN would never run out."""
        if not math.isfinite(params.RequestedSessionTimeout):
            params.RequestedSessionTimeout = self.iserver.max_session_timeout_ms
        return await super().create_session(params, sockname=sockname)

    # --- values and methods -----------------------------------------------------------------------

    async def read(self, params: ua.ReadParameters) -> list[ua.DataValue]:
        """Answer the Read service; what depends on the user is that of this user."""
        items = self._limit(params.NodesToRead)
        if not params.MaxAge >= 0:
            raise ServiceError(_Codes.BadMaxAgeInvalid)
        values: list[ua.DataValue] = self.iserver.attribute_service.read(params)
        for position, item in enumerate(items):
            if item.AttributeId in _BY_USER:
                values[position] = self._by_user(item, values[position])
        return values

    def _by_user(self, item: ua.ReadValueId, value: ua.DataValue) -> ua.DataValue:
        name = item.NodeId.Identifier
        if not isinstance(name, str) or value.Value is None or not value.Value.Value:
            return value
        access, kept = self.iserver.access, value.Value.Value
        if item.AttributeId == ua.AttributeIds.UserExecutable:
            kept = kept and access.may_call(self.user, name.removeprefix("methods."))
        elif not access.may_write(self.user, name):
            kept &= ~ua.AccessLevel.CurrentWrite.mask
        return ua.DataValue(ua.Variant(kept, value.Value.VariantType), value.StatusCode)

    async def write(self, params: ua.WriteParameters) -> list[ua.StatusCode]:
        """Answer the Write service."""
        answers = self.iserver.door.write(self._limit(params.NodesToWrite), self.user)
        self.texts = [answer.text for answer in answers]
        return [ua.StatusCode(answer.code) for answer in answers]

    async def call(self, params: list[ua.CallMethodRequest]) -> list[ua.CallMethodResult]:
        """Answer the Call service."""
        results: list[ua.CallMethodResult] = []
        texts: list[str] = []
        for request in self._limit(params):
            if request.MethodId in self.iserver.methods:
                result, text = await self.iserver.methods.call(request, self.user)
            else:
                code = ua.StatusCode(_Codes.BadMethodInvalid)
                result, text = ua.CallMethodResult(StatusCode=code), ""
            results.append(result)
            texts.append(text)
        self.texts = texts
        return results

    # --- views ------------------------------------------------------------------------------------

    async def browse(self, params: ua.BrowseParameters) -> list[ua.BrowseResult]:
        """Answer the Browse service; long answers come in pages."""
        self._limit(params.NodesToBrowse)
        return self._pages.browse(params)

    async def browse_next(self, parameters: ua.BrowseNextParameters) -> list[ua.BrowseResult]:
        """Answer the BrowseNext service."""
        self._limit(parameters.ContinuationPoints)
        return self._pages.browse_next(parameters)

    async def translate_browsepaths_to_nodeids(
        self, params: list[ua.BrowsePath]
    ) -> list[ua.BrowsePathResult]:
        """Answer the TranslateBrowsePathsToNodeIds service."""
        results: list[ua.BrowsePathResult] = []
        for path in self._limit(params):
            elements = path.RelativePath.Elements or []
            if not elements:
                code = _Codes.BadNothingToDo
            elif len(elements) > _MAX_PATH_ELEMENTS:
                code = _Codes.BadTooManyMatches
            else:
                results += self.iserver.view_service.translate_browsepaths_to_nodeids([path])
                continue
            results.append(ua.BrowsePathResult(StatusCode=ua.StatusCode(code)))
        return results

    # --- subscriptions ----------------------------------------------------------------------------

    def _own(self, subscription_id: int) -> Any:
        """Return a subscription of this session; others do not exist for it."""
        found = self.subscription_service.subscriptions.get(subscription_id)
        if found is None or found.session_id != self.session_id:
            raise ServiceError(_Codes.BadSubscriptionIdInvalid)
        return found

    def _is_own(self, subscription_id: int) -> bool:
        found = self.subscription_service.subscriptions.get(subscription_id)
        return found is not None and found.session_id == self.session_id

    async def create_subscription(
        self, params: Any, callback: Any, request_callback: Any = None
    ) -> ua.CreateSubscriptionResult:
        """Create a subscription that belongs to this session."""
        result = await super().create_subscription(params, callback, request_callback)
        self.subscription_service.subscriptions[result.SubscriptionId].owner = self.owner
        return result

    def modify_subscription(
        self, params: ua.ModifySubscriptionParameters
    ) -> ua.ModifySubscriptionResult:
        """Change intervals and limits of a subscription of this session."""
        self._own(params.SubscriptionId)
        return super().modify_subscription(params)

    async def create_monitored_items(self, params: Any) -> Any:
        """Monitor values or events in a subscription of this session."""
        self._own(params.SubscriptionId)
        self._limit(params.ItemsToCreate)
        return await super().create_monitored_items(params)

    async def modify_monitored_items(self, params: Any) -> Any:
        """Change monitored items of this session."""
        self._own(params.SubscriptionId)
        self._limit(params.ItemsToModify)
        return await super().modify_monitored_items(params)

    async def delete_monitored_items(self, params: Any) -> Any:
        """Delete monitored items of this session."""
        self._own(params.SubscriptionId)
        self._limit(params.MonitoredItemIds)
        return await super().delete_monitored_items(params)

    async def set_monitoring_mode(self, params: Any) -> Any:
        """Switch monitored items of this session on or off."""
        self._own(params.SubscriptionId)
        self._limit(params.MonitoredItemIds)
        return await super().set_monitoring_mode(params)

    async def set_publishing_mode(self, params: Any) -> list[ua.StatusCode]:
        """Switch subscriptions of this session on or off."""
        results = []
        for subscription_id in self._limit(params.SubscriptionIds):
            if self._is_own(subscription_id):
                subscription = self.subscription_service.subscriptions[subscription_id]
                await subscription.set_publishing_mode(params.PublishingEnabled)
                results.append(ua.StatusCode())
            else:
                results.append(ua.StatusCode(_Codes.BadSubscriptionIdInvalid))
        return results

    def republish(self, params: ua.RepublishParameters) -> ua.NotificationMessage:
        """Send a notification of a subscription of this session again."""
        subscription = self._own(params.SubscriptionId)
        if params.RetransmitSequenceNumber not in subscription._not_acknowledged_results:
            raise ServiceError(_Codes.BadMessageNotAvailable)
        return subscription.republish(params.RetransmitSequenceNumber)

    async def delete_subscriptions(self, ids: list[int]) -> list[ua.StatusCode]:
        """Delete subscriptions of this session; those of others do not exist for it."""
        own = [subscription_id for subscription_id in ids or [] if self._is_own(subscription_id)]
        deleted = dict(zip(own, await super().delete_subscriptions(own), strict=True))
        unknown = ua.StatusCode(_Codes.BadSubscriptionIdInvalid)
        return [deleted.pop(subscription_id, unknown) for subscription_id in ids or []]

    def publish(
        self, acks: Sequence[ua.SubscriptionAcknowledgement] | None = None
    ) -> tuple[int, list[ua.StatusCode]]:
        """Take a Publish request: acknowledge what was received."""
        own = len(self.subscription_service.of(self))
        if not own:
            raise ServiceError(_Codes.BadNoSubscription)
        results = []
        for ack in acks or []:
            code = _Codes.BadSubscriptionIdInvalid
            if self._is_own(ack.SubscriptionId):
                waiting = self.subscription_service.subscriptions[
                    ack.SubscriptionId
                ]._not_acknowledged_results
                known = waiting.pop(ack.SequenceNumber, None) is not None
                code = _Codes.Good if known else _Codes.BadSequenceNumberUnknown
            results.append(ua.StatusCode(code))
        return own, results

    async def transfer_subscriptions(self, params: Any, callback: Any) -> list[ua.TransferResult]:
        """Take over subscriptions that the same user of the same program left behind."""
        results: list[ua.TransferResult] = []
        for subscription_id in self._limit(params.SubscriptionIds):
            found = self.subscription_service.subscriptions.get(subscription_id)
            code = _Codes.BadSubscriptionIdInvalid
            if found is not None:
                code = _Codes.Good if found.owner == self.owner else _Codes.BadUserAccessDenied
            # Without a certificate nobody can tell two anonymous clients apart.
            if code == _Codes.Good and not self._certificate and self.user.name is None:
                code = _Codes.BadUserAccessDenied
            result = ua.TransferResult(StatusCode=ua.StatusCode(code))
            if code == _Codes.Good:
                found.session_id = self.session_id
                found.pub_result_callback = callback
                found.pub_request_callback = self.processor.get_publish_request
                result.AvailableSequenceNumbers = sorted(found._not_acknowledged_results)
            results.append(result)
        return results


_BY_USER = {ua.AttributeIds.UserAccessLevel, ua.AttributeIds.UserExecutable}
