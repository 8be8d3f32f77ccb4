"""Answers the messages of one connection.

Every message is answered, or the connection is closed with an Error message that says why. What
needs a session needs its authentication token too, on the channel that the session is bound to.
"""

import asyncio
import struct
from collections.abc import Sequence
from typing import Any

from asyncua import ua
from asyncua.common.connection import TransportLimits
from asyncua.common.utils import NotEnoughData, ServiceError
from asyncua.crypto.uacrypto import InvalidSignature
from asyncua.server.uaprocessor import UaProcessor
from asyncua.ua.ua_binary import (
    header_from_binary,
    nodeid_from_binary,
    struct_from_binary,
    uatcp_to_binary,
)

from hilserver.io.opcua_security.certificate import application_uris, parse_certificate
from hilserver.io.opcua_server.channel import GuardedConnection
from hilserver.io.opcua_server.frames import Stage, TransportError, check_order
from hilserver.io.opcua_server.identity import identify
from hilserver.io.opcua_server.logs import log
from hilserver.io.opcua_server.sessions import RobotSession

_MAX_UNREAD_BYTES = 4 * 1024 * 1024
_OPERATION_TEXT, _OPERATION_ADDITIONAL_INFO = 0x40, 0x80
"""Bits of ReturnDiagnostics (OPC 10000-4, RequestHeader)."""
_MAX_CLIENT_TEXT = 4096
_NONCE_BYTES = 32
_Codes, _Ids, _Type = ua.StatusCodes, ua.ObjectIds, ua.MessageType
_None = ua.MessageSecurityMode.None_
_DISCOVERY = {
    _Ids.GetEndpointsRequest_Encoding_DefaultBinary,
    _Ids.FindServersRequest_Encoding_DefaultBinary,
    _Ids.CloseSecureChannelRequest_Encoding_DefaultBinary,
}
_REGISTRATION = {
    _Ids.RegisterServerRequest_Encoding_DefaultBinary,
    _Ids.RegisterServer2Request_Encoding_DefaultBinary,
}
_MANAGEMENT = {
    _Ids.AddNodesRequest_Encoding_DefaultBinary,
    _Ids.DeleteNodesRequest_Encoding_DefaultBinary,
    _Ids.AddReferencesRequest_Encoding_DefaultBinary,
    _Ids.DeleteReferencesRequest_Encoding_DefaultBinary,
}
_SERVED = {
    _Ids.ReadRequest_Encoding_DefaultBinary,
    _Ids.WriteRequest_Encoding_DefaultBinary,
    _Ids.CallRequest_Encoding_DefaultBinary,
    _Ids.BrowseRequest_Encoding_DefaultBinary,
    _Ids.TranslateBrowsePathsToNodeIdsRequest_Encoding_DefaultBinary,
    _Ids.RegisterNodesRequest_Encoding_DefaultBinary,
    _Ids.UnregisterNodesRequest_Encoding_DefaultBinary,
    _Ids.CreateSubscriptionRequest_Encoding_DefaultBinary,
    _Ids.ModifySubscriptionRequest_Encoding_DefaultBinary,
    _Ids.DeleteSubscriptionsRequest_Encoding_DefaultBinary,
    _Ids.TransferSubscriptionsRequest_Encoding_DefaultBinary,
    _Ids.SetPublishingModeRequest_Encoding_DefaultBinary,
    _Ids.PublishRequest_Encoding_DefaultBinary,
    _Ids.RepublishRequest_Encoding_DefaultBinary,
    _Ids.CreateMonitoredItemsRequest_Encoding_DefaultBinary,
    _Ids.ModifyMonitoredItemsRequest_Encoding_DefaultBinary,
    _Ids.DeleteMonitoredItemsRequest_Encoding_DefaultBinary,
    _Ids.SetMonitoringModeRequest_Encoding_DefaultBinary,
}
_UNDECODABLE = (
    NotEnoughData, struct.error, UnicodeDecodeError, RecursionError, OverflowError, MemoryError,
)  # fmt: skip


class RobotProcessor(UaProcessor):  # type: ignore[misc]
    """Processes the messages of one connection, one after the other."""

    _connection: GuardedConnection
    session: RobotSession | None

    def __init__(self, iserver: Any, transport: Any, policies: Sequence[Any]) -> None:
        super().__init__(iserver, transport, TransportLimits())
        self.address = str(self.name[0]) if self.name else "unknown"
        self._connection = GuardedConnection(policies, iserver.trust, self.address)
        self._is_greeted = False
        self._wanted = 0

    # --- transport --------------------------------------------------------------------------------

    @property
    def stage(self) -> Stage:
        """How far the connection has got."""
        if not self._is_greeted:
            return Stage.NEW
        if not self._connection.is_open():
            return Stage.GREETED
        is_active = self.session is not None and self.session.is_activated()
        return Stage.ACTIVE if is_active else Stage.OPEN

    @property
    def has_parts(self) -> bool:
        """Whether a message is still incomplete."""
        return self._connection.has_parts

    async def process_frame(self, kind: bytes, frame: bytes) -> bool:
        """Process one frame; False if the connection is to be closed."""
        try:
            check_order(self.stage, kind)
            buffer = ua.utils.Buffer(frame)
            header = header_from_binary(buffer)
            if kind == b"HEL":
                self._greet(struct_from_binary(ua.Hello, buffer))
                return True
            return await self._process_chunk(kind, header, buffer)
        except TransportError as error:
            self.refuse(error.code, str(error))
        except InvalidSignature:
            self.refuse(_Codes.BadSecurityChecksFailed, "signature or key does not fit")
        except ua.uaerrors.UaStatusCodeError as error:
            self.refuse(error.code, "refused")
        except _UNDECODABLE:
            self.refuse(_Codes.BadDecodingError, "cannot be decoded")
        except Exception as error:  # noqa: BLE001 - whatever it was, it is one connection's
            secure = self._connection.security_policy.Mode != _None or kind == b"OPN"
            code = _Codes.BadSecurityChecksFailed if secure else _Codes.BadDecodingError
            log.warning("opcua message refused", address=self.address, error=repr(error)[:200])
            self.refuse(code, "cannot be processed")
        return False

    def _greet(self, hello: ua.Hello) -> None:
        answer = self._connection.greet(hello, self.iserver.config.max_message_bytes)
        self._is_greeted = True
        self._transport.write(uatcp_to_binary(_Type.Acknowledge, answer))

    async def _process_chunk(self, kind: bytes, header: ua.Header, buffer: Any) -> bool:
        connection = self._connection
        if self.stage is Stage.ACTIVE:
            connection.max_bytes = self.iserver.config.max_message_bytes
        message = connection.receive_from_header_and_body(header, buffer)
        if message is None:
            return True
        if kind == b"OPN":
            connection.check_asymmetric(message.SecurityHeader())
            if nodeid_from_binary(message.body()) != ua.NodeId(
                _Ids.OpenSecureChannelRequest_Encoding_DefaultBinary
            ):
                raise TransportError(_Codes.BadTcpMessageTypeInvalid, "no OpenSecureChannel")
            self.open_secure_channel(
                message.SecurityHeader(), message.SequenceHeader(), message.body()
            )
            return True
        if kind == b"CLO":
            connection.close()
            return False
        return await self.process_message(message.SequenceHeader(), message.body())

    def refuse(self, code: int, text: str) -> None:
        """Send an Error message and close."""
        if self._transport.is_closing():
            return
        error = ua.ErrorMessage(ua.StatusCode(code), text)
        self._transport.write(uatcp_to_binary(_Type.Error, error))
        self._transport.close()

    def send_response(
        self, requesthandle: Any, seqhdr: Any, response: Any, msgtype: Any = _Type.SecureMessage
    ) -> None:
        """Send a response, with diagnostics where the client asked for them."""
        if self._transport.is_closing():
            return  # uvloop raises on a write to a closed connection
        if self._transport.get_write_buffer_size() > _MAX_UNREAD_BYTES:
            log.warning("opcua client does not read its answers: closed", client=str(self.name))
            self._transport.abort()
            return
        if isinstance(response, ua.WriteResponse | ua.CallResponse) and self.session is not None:
            explain(response, self.session.texts, self._wanted)
        response.ResponseHeader.RequestHandle = requesthandle
        body = ua.ua_binary.struct_to_binary(response)
        longest = self._connection.max_response_bytes
        if longest and len(body) > longest:
            fault = _fault(_Codes.BadResponseTooLarge, requesthandle)
            body = ua.ua_binary.struct_to_binary(fault)
        self._transport.write(
            self._connection.message_to_binary(
                body, message_type=msgtype, request_id=seqhdr.RequestId
            )
        )

    # --- services ---------------------------------------------------------------------------------

    async def process_message(self, seqhdr: Any, body: Any) -> bool:
        """Answer one message; TransportError if not even its header can be read."""
        type_id = nodeid_from_binary(body)
        header = struct_from_binary(ua.RequestHeader, body)
        try:
            return bool(await self._process_message(type_id, header, seqhdr, body))
        except (ServiceError, ua.uaerrors.UaStatusCodeError) as error:
            code = error.code
        except _UNDECODABLE:
            code = _Codes.BadDecodingError
        except Exception as error:  # noqa: BLE001 - a client must get an answer, and no traceback
            log.warning("opcua request failed", address=self.address, error=repr(error)[:200])
            code = _Codes.BadInternalError
        self.send_response(header.RequestHandle, seqhdr, _fault(code, header.RequestHandle))
        return True

    async def _process_message(self, typeid: Any, requesthdr: Any, seqhdr: Any, body: Any) -> Any:
        self._wanted = requesthdr.ReturnDiagnostics
        service = typeid.Identifier if typeid.NamespaceIndex == 0 else None
        if service in _DISCOVERY:
            return await super()._process_message(typeid, requesthdr, seqhdr, body)
        if service in _REGISTRATION:
            raise ServiceError(_Codes.BadServiceUnsupported)  # this is no discovery server
        if self._connection.is_discovery_only:
            raise ServiceError(_Codes.BadSecurityPolicyRejected)
        if service == _Ids.CreateSessionRequest_Encoding_DefaultBinary:
            response = await self._create_session(body)
        elif service == _Ids.ActivateSessionRequest_Encoding_DefaultBinary:
            response = await self._activate_session(requesthdr, body)
        elif service == _Ids.CloseSessionRequest_Encoding_DefaultBinary:
            response = await self._close_session(requesthdr, body)
        else:
            session = self._require_session(requesthdr)
            if not session.is_activated():
                raise ServiceError(_Codes.BadSessionNotActivated)
            if service == _Ids.BrowseNextRequest_Encoding_DefaultBinary:
                session.touch()
                response = ua.BrowseNextResponse()
                params = struct_from_binary(ua.BrowseNextParameters, body)
                response.Parameters.Results = await session.browse_next(params)
            elif service in _MANAGEMENT:
                raise ServiceError(_Codes.BadUserAccessDenied)
            elif service not in _SERVED:
                raise ServiceError(_Codes.BadServiceUnsupported)
            else:
                return await super()._process_message(typeid, requesthdr, seqhdr, body)
        self.send_response(requesthdr.RequestHandle, seqhdr, response)
        return True

    def _require_session(self, header: ua.RequestHeader) -> RobotSession:
        session = self.session
        if session is None or not session.is_named_by(header.AuthenticationToken):
            raise ServiceError(_Codes.BadSessionIdInvalid)
        return session

    async def _create_session(self, body: Any) -> ua.CreateSessionResponse:
        if self.session is not None:
            if self.session.is_activated():
                raise ServiceError(_Codes.BadTooManySessions)  # one per connection
            await self.session.close_session(True)
            self.session = None
        params = struct_from_binary(ua.CreateSessionParameters, body)
        self._check_client(params)
        policy = self._connection.security_policy
        session = self.iserver.create_session(self.name, external=True)
        session.bind(self, policy)
        self.session = session
        response = ua.CreateSessionResponse()
        response.Parameters = await session.create_session(params, sockname=self.sockname)
        response.Parameters.MaxRequestMessageSize = self.iserver.config.max_message_bytes
        response.Parameters.ServerCertificate = policy.host_certificate
        signed = (policy.peer_certificate or b"") + (params.ClientNonce or b"")
        signature = response.Parameters.ServerSignature
        signature.Signature = policy.asymmetric_cryptography.signature(signed)
        signature.Algorithm = policy.AsymmetricSignatureURI
        return response

    def _check_client(self, params: ua.CreateSessionParameters) -> None:
        """Check that the session is asked for by the application that opened the channel."""
        texts = (params.EndpointUrl, params.SessionName, params.ServerUri)
        if any(len(text or "") > _MAX_CLIENT_TEXT for text in texts):
            raise ServiceError(_Codes.BadInvalidArgument)
        policy = self._connection.security_policy
        if policy.Mode == _None:
            return
        certificate = policy.peer_certificate
        if not (params.ClientCertificate or b"").startswith(certificate):
            raise ServiceError(_Codes.BadSecurityChecksFailed)
        if len(params.ClientNonce or b"") < _NONCE_BYTES:
            raise ServiceError(_Codes.BadNonceInvalid)
        uri = params.ClientDescription.ApplicationUri
        if uri not in application_uris(parse_certificate(certificate)):
            log.warning("opcua certificate names another URI", announced=str(uri)[:200])
            self.iserver.trust.keep_rejected(certificate)
            raise ServiceError(_Codes.BadCertificateUriInvalid)

    async def _activate_session(self, header: Any, body: Any) -> ua.ActivateSessionResponse:
        params = struct_from_binary(ua.ActivateSessionParameters, body)
        session = self.iserver.lookup_external_session(header.AuthenticationToken)
        if session is None or (self.session is not None and session is not self.session):
            raise ServiceError(_Codes.BadSessionIdInvalid)
        policy = self._connection.security_policy
        is_moved = session.processor is not self
        if is_moved and not session.is_activated():
            raise ServiceError(_Codes.BadSessionIdInvalid)
        if not session.is_of(policy):
            raise ServiceError(_Codes.BadSecurityChecksFailed)
        try:
            signed = (policy.host_certificate or b"") + session.nonce
            policy.asymmetric_cryptography.verify(signed, params.ClientSignature.Signature)
        except (InvalidSignature, TypeError):
            raise ServiceError(_Codes.BadApplicationSignatureInvalid) from None
        user = await identify(
            self.iserver.access,
            params.UserIdentityToken,
            is_encrypted=policy.Mode == ua.MessageSecurityMode.SignAndEncrypt,
            key=self.iserver.private_key,
            nonce=session.nonce,
            address=self.address,
        )
        if is_moved:
            if user != session.user:
                raise ServiceError(_Codes.BadUserAccessDenied)
            self._take_over(session, policy)
        response = ua.ActivateSessionResponse()
        response.Parameters = session.activate(user)
        return response

    def _take_over(self, session: RobotSession, policy: Any) -> None:
        """Bind a session of another connection, which has proved to be the same client, to us."""
        if session.processor is not None and session.processor.session is session:
            session.processor.session = None
        session.bind(self, policy)
        self.session, self._closing = session, False
        for subscription in self.iserver.subscription_service.of(session):
            subscription.pub_result_callback = self.forward_publish_response
            subscription.pub_request_callback = self.get_publish_request

    async def _close_session(self, header: Any, body: Any) -> ua.CloseSessionResponse:
        session = self._require_session(header)
        await session.close_session(ua.ua_binary.Primitives.Boolean.unpack(body))
        self.session = None
        return ua.CloseSessionResponse()

    async def close(self) -> None:
        """Let go of the session when the connection is lost; subscriptions may outlive it."""
        self._closing = True
        session, self.session = self.session, None
        if session is None or session.processor is not self:
            return
        session.processor = None
        if not session.is_activated() or not self.iserver.subscription_service.of(session):
            await asyncio.shield(session.close_session(True))


def _fault(code: int, handle: int) -> ua.ServiceFault:
    fault = ua.ServiceFault()
    fault.ResponseHeader.ServiceResult = ua.StatusCode(code)
    fault.ResponseHeader.RequestHandle = handle
    return fault


def explain(response: Any, texts: Sequence[str], wanted: int) -> None:
    """Add the sentences that a client asked for to a Write or Call response."""
    if not any(texts) or not wanted & (_OPERATION_TEXT | _OPERATION_ADDITIONAL_INFO):
        return
    table: list[str] = []
    for text in texts:
        info = ua.DiagnosticInfo()
        if text and wanted & _OPERATION_ADDITIONAL_INFO:
            info.AdditionalInfo = text
        if text and wanted & _OPERATION_TEXT:
            info.LocalizedText = len(table)
            table.append(text)
        response.DiagnosticInfos.append(info)
    response.ResponseHeader.StringTable = table
