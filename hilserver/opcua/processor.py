"""Answers the messages of one connection.

Every message is answered, or the connection is closed with an Error message that has the reason.
Services of a session also need its authentication token, on the channel the session is bound to.
"""

import inspect
import struct
from collections.abc import Sequence
from itertools import zip_longest
from typing import Any

from asyncua import ua
from asyncua.common.utils import Buffer, NotEnoughData, ServiceError
from asyncua.crypto.uacrypto import InvalidSignature
from asyncua.ua.ua_binary import (
    header_from_binary,
    nodeid_from_binary,
    struct_from_binary,
    struct_to_binary,
    uatcp_to_binary,
)

from hilserver.opcua import encoding
from hilserver.opcua.channel import GuardedConnection
from hilserver.opcua.frames import ConnectionStage, TransportError, check_order
from hilserver.opcua.login import activate_session, create_session
from hilserver.opcua.logs import log
from hilserver.opcua.loopback import is_loopback
from hilserver.opcua.node_services import read
from hilserver.opcua.portions import decoded, encoded, take
from hilserver.opcua.rotation import Portions
from hilserver.opcua.services import REPUBLISH, SERVICES
from hilserver.opcua.sessions import Session

_OPERATION_TEXT, _OPERATION_ADDITIONAL_INFO = 0x40, 0x80
"""Bits of ReturnDiagnostics (OPC 10000-4, RequestHeader)."""
_Codes, _Type = ua.StatusCodes, ua.MessageType
_None = ua.MessageSecurityMode.None_
_id = encoding.binary_id


_GET_ENDPOINTS, _FIND_SERVERS = _id("GetEndpointsRequest"), _id("FindServersRequest")
_CREATE, _ACTIVATE = _id("CreateSessionRequest"), _id("ActivateSessionRequest")
_CLOSE, _PUBLISH = _id("CloseSessionRequest"), _id("PublishRequest")
_READ, _REPUBLISH = _id("ReadRequest"), _id("RepublishRequest")
_OPEN = ua.NodeId(_id("OpenSecureChannelRequest"))
_REPUBLISH_RESPONSE = encoding.numeric_id(_id("RepublishResponse"))
_REGISTRATION = {_id("RegisterServerRequest"), _id("RegisterServer2Request")}
_MANAGEMENT = {
    _id(f"{what}Request")
    for what in ("AddNodes", "DeleteNodes", "AddReferences", "DeleteReferences")
}
_UNDECODABLE = (
    NotEnoughData, struct.error, UnicodeDecodeError, RecursionError, OverflowError, MemoryError,
)  # fmt: skip
_ACTING = {_id("WriteRequest"), _id("CallRequest")}
_LOCAL_TIME_MS = 900_000  # time zones differ by quarters of an hour at least
REQUEST_S = 0.5  # of work for one request; the rest of it is refused
LONGEST_WAIT_S = 10.0  # total, for the methods that one Call waits for


class Processor:
    """Processes the messages of one connection, one after the other."""

    def __init__(self, iserver: Any, transport: Any, policies: Sequence[Any]) -> None:
        self.iserver = iserver
        self.session: Session | None = None
        self.is_congested = False  # the client does not read its answers
        self._transport = transport
        self.sockname = transport.get_extra_info("sockname")
        self.socket = transport.get_extra_info("socket")
        name = transport.get_extra_info("peername")
        self.address = str(name[0]) if name else "unknown"
        self._connection = GuardedConnection(policies, iserver.trust, self.address)
        self._is_greeted = False
        # time taken so far by the message being processed, and time spent waiting for others;
        # counted by the connection, which gives us turns
        self.spent_s = self.waited_s = 0.0

    @property
    def is_out_of_time(self) -> bool:
        """Whether the request that is being answered has used up its time."""
        return self.spent_s > REQUEST_S or self.waited_s > LONGEST_WAIT_S

    @property
    def policy(self) -> Any:
        """Security policy of the channel."""
        return self._connection.security_policy

    # --- transport --------------------------------------------------------------------------------

    @property
    def stage(self) -> ConnectionStage:
        """Stage of the connection."""
        if not self._is_greeted:
            return ConnectionStage.NEW
        if not self._connection.is_open():
            return ConnectionStage.GREETED
        is_active = self.session is not None and self.session.is_activated
        return ConnectionStage.ACTIVE if is_active else ConnectionStage.OPEN

    @property
    def has_parts(self) -> bool:
        """Whether a message is still incomplete."""
        return self._connection.has_parts

    def process_frame(self, kind: bytes, frame: bytes) -> bool | Portions:
        """Process one frame, or start to; the result is False if the connection must be closed."""
        try:
            return self._process_frame(kind, frame)
        except Exception as error:  # noqa: BLE001 - whatever it was, it is one connection's
            if isinstance(error, TransportError):
                self.refuse(error.code, str(error))
            elif isinstance(error, InvalidSignature):
                self.refuse(
                    _Codes.BadSecurityChecksFailed, "the signature or key is wrong"
                )
            elif isinstance(error, ServiceError | ua.uaerrors.UaStatusCodeError):
                self.refuse(error.code, "refused")
            elif isinstance(error, _UNDECODABLE):
                self.refuse(_Codes.BadDecodingError, "cannot be decoded")
            else:
                secure = (
                    self._connection.security_policy.Mode != _None or kind == b"OPN"
                )
                if secure:
                    code = _Codes.BadSecurityChecksFailed
                else:
                    code = _Codes.BadDecodingError
                log.warning(
                    "opcua message refused",
                    address=self.address,
                    error=repr(error)[:200],
                )
                self.refuse(code, "cannot be processed")
            return False

    def _process_frame(self, kind: bytes, frame: bytes) -> bool | Portions:
        check_order(self.stage, kind)
        connection = self._connection
        if self.stage is ConnectionStage.ACTIVE:
            connection.max_bytes = self.iserver.settings.max_message_bytes
        if kind == b"MSG":
            plain = connection.receive_plain(frame)
            if plain is not None:
                return self._process_message(*plain)
        buffer = Buffer(frame)
        header = header_from_binary(buffer)
        if kind == b"HEL":
            hello = struct_from_binary(ua.Hello, buffer)
            answer = self._connection.greet(
                hello, self.iserver.settings.max_message_bytes
            )
            self._is_greeted = True
            self._transport.write(uatcp_to_binary(_Type.Acknowledge, answer))
            return True
        message = connection.receive_from_header_and_body(header, buffer)
        if message is None:
            return True
        if kind == b"CLO":
            connection.close()
            return False
        request_id = message.SequenceHeader().RequestId
        body = message.body()
        if kind == b"OPN":
            connection.check_asymmetric(message.SecurityHeader(), header.ChannelId)
            self._open_channel(message.SecurityHeader(), request_id, body)
            return True
        return self._process_message(request_id, body)

    def _open_channel(self, security: Any, request_id: int, body: Buffer) -> None:
        if nodeid_from_binary(body) != _OPEN:
            raise TransportError(
                _Codes.BadTcpMessageTypeInvalid, "no OpenSecureChannel"
            )
        head = take(ua.RequestHeader, body)
        params = take(ua.OpenSecureChannelParameters, body)
        connection = self._connection
        if not connection.is_open():
            connection.select_policy(
                security.SecurityPolicyURI,
                security.SenderCertificate,
                params.SecurityMode,
            )
        response = ua.OpenSecureChannelResponse()
        response.Parameters = connection.open(params, self.iserver)
        response.ResponseHeader.RequestHandle = head.RequestHandle
        data = bytes(struct_to_binary(response))
        self._transport.write(
            connection.message_to_binary(data, _Type.SecureOpen, request_id)
        )

    def refuse(self, code: int, text: str) -> None:
        """Send an Error message and close."""
        if self._transport.is_closing():
            return
        error = ua.ErrorMessage(ua.StatusCode(code), text)
        self._transport.write(uatcp_to_binary(_Type.Error, error))
        self._transport.close()

    # --- answers ----------------------------------------------------------------------------------

    def send_body(self, request_id: int, handle: int, body: bytes) -> None:
        """Send an encoded response, or a fault if it is too long for the client."""
        if self._transport.is_closing():
            return  # uvloop raises on a write to a closed connection
        longest = self._connection.max_response_bytes
        if self.session is not None and self.session.max_response_bytes:
            agreed = self.session.max_response_bytes
            longest = min(longest, agreed) if longest else agreed
        if longest and len(body) > longest:
            body = _fault(_Codes.BadResponseTooLarge, handle)
        self._transport.write(self._connection.message_bytes(body, request_id))

    def send_fault(self, request_id: int, handle: int, code: int) -> None:
        """Send the fault of a request that failed as a whole."""
        self.send_body(request_id, handle, _fault(code, handle))

    def _send(
        self, request_id: int, head: encoding.RequestHead, response: Any
    ) -> Portions:
        """Send a response, with diagnostics if the client requested them."""
        if not isinstance(response, bytes):
            if (
                isinstance(response, ua.WriteResponse | ua.CallResponse)
                and self.session is not None
            ):
                explain(response, self.session.texts, head.diagnostics)
            response.ResponseHeader.RequestHandle = head.handle
            response = yield from encoded(response)
        self.send_body(request_id, head.handle, response)

    # --- services ---------------------------------------------------------------------------------

    def _process_message(self, request_id: int, body: Buffer) -> bool | Portions:
        """Answer one message, or start to; raise if not even its header can be read."""
        service = encoding.service_id(body)
        session = self.session
        token = None
        if session is None:
            head = None
        else:
            head = encoding.request_head(body, session.token_bytes)
        if head is None:
            header = take(ua.RequestHeader, body)
            token = header.AuthenticationToken
            head = encoding.RequestHead(
                header.RequestHandle,
                header.ReturnDiagnostics,
                header.TimeoutHint,
                0,
            )
            if session is not None and not session.is_named_by(token):
                session = None
        try:
            response = self._serve(service, session, token, head, request_id, body)
        except Exception as error:  # noqa: BLE001 - a client must get an answer, and no traceback
            self.send_fault(request_id, head.handle, self._code_of(error))
            return True
        return True if response is None else self._finish(response, request_id, head)

    def _finish(
        self, response: Any, request_id: int, head: encoding.RequestHead
    ) -> Portions:
        """Send the answer when the request has been carried out."""
        try:
            if inspect.iscoroutine(response):
                response = yield response
            elif inspect.isgenerator(response):
                response = yield from response
            yield from self._send(request_id, head, response)
        except Exception as error:  # noqa: BLE001 - as above
            self.send_fault(request_id, head.handle, self._code_of(error))
        return True

    def _code_of(self, error: Exception) -> int:
        if isinstance(error, ServiceError | ua.uaerrors.UaStatusCodeError):
            return int(error.code)
        if isinstance(error, _UNDECODABLE):
            return int(_Codes.BadDecodingError)
        log.warning(
            "opcua request failed", address=self.address, error=repr(error)[:200]
        )
        return int(_Codes.BadInternalError)

    def _serve(
        self,
        service: Any,
        session: Any,
        token: Any,
        head: Any,
        request_id: int,
        body: Buffer,
    ) -> Any:
        if service in (_GET_ENDPOINTS, _FIND_SERVERS):
            return self._discover(service, body)
        if service in _REGISTRATION:
            raise ServiceError(_Codes.BadServiceUnsupported)  # not a discovery server
        if self._connection.is_discovery_only:
            raise ServiceError(_Codes.BadSecurityPolicyRejected)
        if service == _CREATE:
            return create_session(self, take(ua.CreateSessionParameters, body))
        if service == _ACTIVATE:
            token = session.auth_token if session is not None else token
            return activate_session(
                self, token, take(ua.ActivateSessionParameters, body)
            )
        if session is None:
            raise ServiceError(_Codes.BadSessionIdInvalid)
        session.touch()
        if service == _CLOSE:
            session.close(delete_subscriptions=body.read(1) != b"\0")
            return ua.CloseSessionResponse()
        if not session.is_activated:
            raise ServiceError(_Codes.BadSessionNotActivated)
        return self._serve_session(service, session, head, request_id, body)

    def _serve_session(
        self, service: Any, session: Any, head: Any, request_id: int, body: Buffer
    ) -> Any:
        if service == _PUBLISH:
            return session.publish(head, request_id, body)
        if service == _READ:
            return self._read(session, head, body)
        if service == _REPUBLISH:
            message = REPUBLISH.answer(session, take(REPUBLISH.parameters, body))
            return encoding.response_head(_REPUBLISH_RESPONSE, head.handle) + message
        if service in _MANAGEMENT:
            raise ServiceError(_Codes.BadUserAccessDenied)
        if service not in SERVICES:
            raise ServiceError(_Codes.BadServiceUnsupported)
        if service in _ACTING and self._has_expired(head):
            raise ServiceError(_Codes.BadTimeout)
        return self._answer(session, *SERVICES[service], body)

    def _has_expired(self, head: encoding.RequestHead) -> bool:
        """Whether the client has given this request up long ago, as we stood still.

        Only of clients that share our clock. One that gives local time would always be too late.
        """
        age_ms = (encoding.utc_now() - head.sent) / 1e4
        is_late = 0 < head.timeout_ms < age_ms < _LOCAL_TIME_MS
        return is_late and is_loopback(self.address)

    def _read(self, session: Any, head: Any, body: Buffer) -> Portions:
        items = yield from encoding.read_items(
            body, self.iserver.settings.max_operations
        )
        values = yield from read(session, items)
        return encoding.read_response(head.handle, values)

    def _answer(
        self, session: Any, parameters: type, answer: Any, body: Buffer
    ) -> Portions:
        params = yield from decoded(
            parameters, body, self.iserver.settings.max_operations
        )
        response = answer(session, params)
        return (yield from response) if inspect.isgenerator(response) else response

    async def _discover(self, service: int, body: Buffer) -> Any:
        if service == _FIND_SERVERS:
            find = take(ua.FindServersParameters, body)
            servers = self.iserver.find_servers(find, self.sockname)
            return ua.FindServersResponse(Servers=servers)
        params = take(ua.GetEndpointsParameters, body)
        endpoints = await self.iserver.get_endpoints(params, self.sockname)
        return ua.GetEndpointsResponse(Endpoints=endpoints)


def _fault(code: int, handle: int) -> bytes:
    return encoding.response_head(_FAULT, handle, int(code))


_FAULT = encoding.numeric_id(_id("ServiceFault"))


def explain(response: Any, texts: Sequence[str], wanted: int) -> None:
    """Add sentences to a Write or Call response if the client requested them."""
    if not any(texts) or not wanted & (_OPERATION_TEXT | _OPERATION_ADDITIONAL_INFO):
        return
    table: list[str] = []
    for _, text in zip_longest(response.Results, texts, fillvalue=""):
        info = ua.DiagnosticInfo()
        if text and wanted & _OPERATION_ADDITIONAL_INFO:
            info.AdditionalInfo = text
        if text and wanted & _OPERATION_TEXT:
            info.LocalizedText = len(table)
            table.append(text)
        response.DiagnosticInfos.append(info)
    response.ResponseHeader.StringTable = table
