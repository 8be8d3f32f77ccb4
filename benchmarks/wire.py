"""A client that speaks OPC UA's binary protocol frame by frame, so that it can also violate it."""

import asyncio
import contextlib
import struct
from datetime import UTC, datetime
from types import TracebackType
from typing import Any, Self
from urllib.parse import urlsplit

from asyncua import ua
from asyncua.common.utils import Buffer
from asyncua.ua.ua_binary import (
    nodeid_from_binary,
    struct_from_binary,
    struct_to_binary,
)

POLICY_NONE = "http://opcfoundation.org/UA/SecurityPolicy#None"
ANSWER_WITHIN_S = 5.0
_FAULT = ua.NodeId(ua.ObjectIds.ServiceFault_Encoding_DefaultBinary)
_HEADER = struct.Struct("<3scI")


def frame(
    kind: bytes, body: bytes, chunk: bytes = b"F", size: int | None = None
) -> bytes:
    """Return a frame; `size` may be wrong on purpose."""
    return _HEADER.pack(kind, chunk, 8 + len(body) if size is None else size) + body


def hello(url: str, buffer_bytes: int = 65_535) -> bytes:
    """Return a Hello message."""
    text = url.encode()
    numbers = struct.pack("<IIIII", 0, buffer_bytes, buffer_bytes, 0, 0)
    return frame(b"HEL", numbers + struct.pack("<i", len(text)) + text)


def open_channel(sequence: int = 1, policy: str = POLICY_NONE) -> bytes:
    """Return an OpenSecureChannel message without security, always the same one."""
    request = ua.OpenSecureChannelRequest()
    request.RequestHeader.Timestamp = datetime(2024, 1, 1, tzinfo=UTC)
    request.Parameters.SecurityMode = ua.MessageSecurityMode.None_
    # Nothing here renews a channel, and a bench outlives the usual minute.
    request.Parameters.RequestedLifetime = 3_600_000
    request.Parameters.ClientNonce = b""
    uri = policy.encode()
    head = struct.pack("<Ii", 0, len(uri)) + uri + struct.pack("<ii", -1, -1)
    return frame(
        b"OPN",
        head + struct.pack("<II", sequence, sequence) + struct_to_binary(request),
    )


class Wire:
    """One connection.

    Attributes
    ----------
    channel, token : int
        Numbers assigned by the server; 0 before.
    authentication : NodeId
        Sent with every request.
    """

    def __init__(self, url: str) -> None:
        self.url = url
        self.channel = self.token = self._sequence = 0
        self.authentication = ua.NodeId()
        self._reader: asyncio.StreamReader
        self._writer: asyncio.StreamWriter

    async def __aenter__(self) -> Self:
        parts = urlsplit(self.url)
        self._reader, self._writer = await asyncio.open_connection(
            parts.hostname, parts.port
        )
        return self

    async def __aexit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        _: TracebackType | None,
    ) -> None:
        self._writer.transport.abort()
        with contextlib.suppress(OSError):
            await self._writer.wait_closed()

    def abort(self) -> None:
        """Close without notice."""
        self._writer.transport.abort()

    async def send(self, data: bytes) -> None:
        """Send arbitrary bytes."""
        self._writer.write(data)
        await self._writer.drain()

    async def receive(self, within_s: float = ANSWER_WITHIN_S) -> tuple[bytes, bytes]:
        """Return kind and body of the next frame; (b"", b"") when the server has closed."""
        async with asyncio.timeout(within_s):
            try:
                kind, _, size = _HEADER.unpack(
                    await self._reader.readexactly(_HEADER.size)
                )
                return kind, await self._reader.readexactly(size - _HEADER.size)
            except (asyncio.IncompleteReadError, ConnectionError):
                return b"", b""

    async def greet(self) -> None:
        """Send Hello and take the answer."""
        await self.send(hello(self.url))
        kind, body = await self.receive()
        _expect(kind, body, b"ACK")

    async def open(self) -> None:
        """Open a channel without security."""
        self._sequence += 1
        await self.send(open_channel(self._sequence))
        kind, body = await self.receive()
        _expect(kind, body, b"OPN")
        data = Buffer(body)
        data.skip(4)
        struct_from_binary(ua.AsymmetricAlgorithmHeader, data)
        data.skip(8)
        response = struct_from_binary(ua.OpenSecureChannelResponse, data)
        token = response.Parameters.SecurityToken
        self.channel, self.token = token.ChannelId, token.TokenId

    def message(self, request: Any, chunk: bytes = b"F") -> bytes:
        """Return the message that carries a request (or bytes)."""
        if not isinstance(request, bytes):
            request.RequestHeader.AuthenticationToken = self.authentication
            request = struct_to_binary(request)
        self._sequence += 1
        head = struct.pack(
            "<IIII", self.channel, self.token, self._sequence, self._sequence
        )
        return frame(b"MSG", head + request, chunk)

    async def ask(self, request: Any, answer: type) -> Any:
        """Send a request and return its answer.

        Raises
        ------
        asyncua.ua.UaStatusCodeError
            If the server answered with a fault or an Error message.
        ConnectionError
            If it closed the connection.
        """
        await self.send(self.message(request))
        kind, body = await self.receive()
        _expect(kind, body, b"MSG")
        data = Buffer(body[16:])
        if nodeid_from_binary(data.copy()) == _FAULT:
            struct_from_binary(
                ua.ServiceFault, data
            ).ResponseHeader.ServiceResult.check()
        response = struct_from_binary(answer, data)
        response.ResponseHeader.ServiceResult.check()
        return response

    async def create_session(self) -> Any:
        """Create a session; its token is used from here on."""
        request = ua.CreateSessionRequest()
        request.Parameters.EndpointUrl = self.url
        request.Parameters.SessionName = "wire"
        request.Parameters.RequestedSessionTimeout = 60_000
        request.Parameters.ClientNonce = b"\x01" * 32
        response = await self.ask(request, ua.CreateSessionResponse)
        self.authentication = response.Parameters.AuthenticationToken
        return response.Parameters

    async def activate_session(self, policy: str = "anonymous") -> Any:
        """Activate the session as an anonymous user, as the server's token policy is named."""
        request = ua.ActivateSessionRequest()
        request.Parameters.UserIdentityToken = ua.AnonymousIdentityToken(
            PolicyId=policy
        )
        return await self.ask(request, ua.ActivateSessionResponse)

    async def log_in(self) -> None:
        """Do all steps up to an activated session."""
        await self.greet()
        await self.open()
        session = await self.create_session()
        tokens = [
            token
            for endpoint in session.ServerEndpoints
            for token in endpoint.UserIdentityTokens
        ]
        policy = next(
            token.PolicyId
            for token in tokens
            if token.TokenType == ua.UserTokenType.Anonymous
        )
        await self.activate_session(policy)

    async def write(self, node_id: ua.NodeId, value: Any, kind: ua.VariantType) -> str:
        """Write one value; return the name of the status code."""
        request = ua.WriteRequest()
        item = ua.WriteValue(NodeId=node_id, AttributeId=ua.AttributeIds.Value)
        item.Value = ua.DataValue(ua.Variant(value, kind))
        request.Parameters.NodesToWrite = [item]
        return str((await self.ask(request, ua.WriteResponse)).Results[0].name)

    async def read(self, *node_ids: ua.NodeId) -> list[ua.DataValue]:
        """Read values."""
        request = ua.ReadRequest()
        request.Parameters.NodesToRead = [
            ua.ReadValueId(NodeId=node_id, AttributeId=ua.AttributeIds.Value)
            for node_id in node_ids
        ]
        return list((await self.ask(request, ua.ReadResponse)).Results)


def _expect(kind: bytes, body: bytes, wanted: bytes) -> None:
    if kind == b"ERR":
        raise ua.UaStatusCodeError(struct.unpack_from("<I", body)[0])
    if kind != wanted:
        raise ConnectionError(
            "the server has closed the connection" if not kind else str(kind)
        )
