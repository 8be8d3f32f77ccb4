"""The secure channel of one connection: asyncua's, without its loopholes.

asyncua falls back to policy None whatever the server's settings, answers messages without a
preceding OpenSecureChannel, and accepts expired keys. Here a channel is opened once with a policy
that is offered and a certificate that is trusted; if policy None is not offered, it is good for
discovery only.
"""

import hashlib
import struct
import time
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.common.utils import Buffer
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone

from hilserver.opcua.certificate import first_of_chain, parse_certificate, thumbprint
from hilserver.opcua.frames import MAX_CHUNK_BYTES, TransportError
from hilserver.opcua.logs import log
from hilserver.opcua.trust_list import CertificateVerdict, TrustList

MAX_BYTES_BEFORE_LOGIN = 65_536
MIN_BUFFER_BYTES = 8192
_MIN_LIFETIME_MS, _MAX_LIFETIME_MS = 10_000, 3_600_000
_MIN_CHUNK_BYTES = 4096
_NONCE_BYTES = 32
_MAX_URL_BYTES = 4096
_PLAIN = struct.Struct("<3scIIIII")
_MAX_SEQUENCE, _WRAP = 2**32 - 1, 1024
_Codes = ua.StatusCodes
_None = ua.MessageSecurityMode.None_
# OPC 10000-4, 6.1.3: an untrusted client learns only that it is not trusted.
_CONCEALED = {
    CertificateVerdict.INVALID,
    CertificateVerdict.UNTRUSTED,
    CertificateVerdict.POLICY,
}


class GuardedConnection(SecureConnection):  # type: ignore[misc]
    """Encodes, decodes and checks the messages of one connection."""

    _peer_sequence_number: int | None
    _sequence_number: int

    def __init__(
        self,
        policies: Sequence[SecurityPolicyFactory],
        trust: TrustList | None,
        peer: str,
    ) -> None:
        super().__init__(SecurityPolicyNone(), TransportLimits())
        self.set_policy_factories(list(policies))
        # the channel is not protected, and the server does not offer that for sessions
        self.is_discovery_only = False
        # longest request accepted at this point
        self.max_bytes = MAX_BYTES_BEFORE_LOGIN
        # longest response that the client accepts, 0 for any
        self.max_response_bytes = 0
        self._expiring = (0, 0.0)
        self._trust = trust
        self._peer = peer

    def greet(self, hello: ua.Hello, max_bytes: int) -> ua.Acknowledge:
        """Agree on sizes; TransportError if the client's buffer sizes are invalid."""
        if min(hello.ReceiveBufferSize, hello.SendBufferSize) < MIN_BUFFER_BYTES:
            raise TransportError(
                _Codes.BadConnectionRejected, "buffers below 8192 bytes"
            )
        if len(hello.EndpointUrl or "") > _MAX_URL_BYTES:
            raise TransportError(
                _Codes.BadTcpEndpointUrlInvalid, "endpoint URL too long"
            )
        answer = ua.Acknowledge()
        answer.ReceiveBufferSize = min(hello.SendBufferSize, MAX_CHUNK_BYTES)
        answer.SendBufferSize = min(hello.ReceiveBufferSize, MAX_CHUNK_BYTES)
        answer.MaxMessageSize = max_bytes
        answer.MaxChunkCount = max_bytes // _MIN_CHUNK_BYTES
        self._limits.max_send_buffer = answer.SendBufferSize
        chunks_bytes = hello.MaxChunkCount * answer.SendBufferSize
        self.max_response_bytes = min(
            (size for size in (hello.MaxMessageSize, chunks_bytes) if size), default=0
        )
        return answer

    @property
    def has_parts(self) -> bool:
        """Whether a message is still incomplete."""
        return bool(self._incoming_parts)

    def select_policy(
        self,
        uri: str,
        peer_certificate: bytes | None,
        mode: ua.MessageSecurityMode | None = None,
    ) -> None:
        """Choose the policy of a new channel; asyncua calls this before and after decrypting."""
        if uri == SecurityPolicyNone.URI:
            self.is_discovery_only = not any(
                p.matches(uri, _None) for p in self._policies
            )
            self.security_policy = SecurityPolicyNone()
            if mode not in (None, _None):
                raise TransportError(
                    _Codes.BadSecurityModeRejected, "mode without a policy"
                )
            return
        factory = next((p for p in self._policies if p.matches(uri, mode)), None)
        if factory is None:
            if mode is None:
                code = _Codes.BadSecurityPolicyRejected
            else:
                code = _Codes.BadSecurityModeRejected
            raise TransportError(code, "security policy or mode not offered")
        if mode is not None:
            return  # already decrypted with this policy, and checked
        self._judge(peer_certificate or b"")
        self.security_policy = factory.create(first_of_chain(peer_certificate or b""))

    def _judge(self, certificate: bytes) -> None:
        if self._trust is None:
            verdict = CertificateVerdict.INVALID
        else:
            verdict = self._trust.judge(certificate)
        if verdict is CertificateVerdict.GOOD:
            return
        kept = remedy = None
        if self._trust is not None:
            path = self._trust.keep_rejected(certificate, self._peer)
            is_crowded = path is None and self._trust.has_kept_many(self._peer)
            kept = "no: too many others lately" if is_crowded else path and path.name
            if path is not None and verdict is CertificateVerdict.UNTRUSTED:
                name = thumbprint(parse_certificate(certificate))
                remedy = f"compare it, then 'hilserver certs trust {name}'"
        log.warning(
            "opcua certificate refused",
            reason=verdict.value,
            address=self._peer,
            kept=kept,
            remedy=remedy,
        )
        code = verdict.value if verdict not in _CONCEALED else "BadSecurityChecksFailed"
        raise TransportError(getattr(_Codes, code), "certificate refused")

    def check_asymmetric(
        self, header: ua.AsymmetricAlgorithmHeader, channel_id: int
    ) -> None:
        """Check that an OpenSecureChannel is meant for us and for this channel."""
        policy = self.security_policy
        if header.SecurityPolicyURI != policy.URI:
            raise TransportError(
                _Codes.BadSecurityChecksFailed, "not the policy of the channel"
            )
        if self._open and channel_id != self.security_token.ChannelId:
            raise TransportError(_Codes.BadSecureChannelIdInvalid, "another channel")
        if policy.URI == SecurityPolicyNone.URI:
            return
        ours = hashlib.sha1(policy.host_certificate, usedforsecurity=False).digest()
        if header.ReceiverCertificateThumbPrint != ours:
            raise TransportError(
                _Codes.BadCertificateInvalid, "encrypted for another certificate"
            )
        if first_of_chain(header.SenderCertificate or b"") != policy.peer_certificate:
            raise TransportError(_Codes.BadSecurityChecksFailed, "another certificate")

    def open(self, params: Any, server: Any) -> ua.OpenSecureChannelResult:
        """Open or renew the channel, with a lifetime within bounds."""
        is_issue = params.RequestType == ua.SecurityTokenRequestType.Issue
        if is_issue == self._open:
            raise TransportError(_Codes.BadRequestTypeInvalid, "issue once, then renew")
        is_secure = self.security_policy.Mode != _None
        if params.SecurityMode != self.security_policy.Mode:
            raise TransportError(
                _Codes.BadSecurityModeRejected, "not the mode of the channel"
            )
        if is_secure and len(params.ClientNonce or b"") != _NONCE_BYTES:
            raise TransportError(_Codes.BadNonceInvalid, "the nonce has 32 bytes")
        if self._open and is_secure:
            self._judge(self.security_policy.peer_certificate)
        asked_ms = params.RequestedLifetime or _MAX_LIFETIME_MS
        params.RequestedLifetime = min(
            max(asked_ms, _MIN_LIFETIME_MS), _MAX_LIFETIME_MS
        )
        return super().open(params, server)

    def receive_plain(self, frame: bytes) -> tuple[int, Buffer] | None:
        """Return request id and body of a whole, unprotected, expected message: the fast path.

        None for any other: `receive_from_header_and_body` checks it and reports what is wrong.
        """
        _, chunk, _, channel, token_id, sequence, request_id = _PLAIN.unpack_from(frame)
        token = self.security_token
        last = self._peer_sequence_number
        if (
            self.security_policy.Mode != _None
            or chunk != b"F"
            or self._incoming_parts
            or (channel, token_id) != (token.ChannelId, token.TokenId)
            or last is None
            or sequence != last + 1
            or self._has_expired()
            or len(frame) > min(self.max_bytes, MAX_CHUNK_BYTES)
        ):
            return None
        self._peer_sequence_number = sequence
        return request_id, Buffer(frame, _PLAIN.size)

    def message_bytes(self, body: bytes, request_id: int) -> bytes:
        """Return the chunks that carry a response."""
        size = _PLAIN.size + len(body)
        if self.security_policy.Mode != _None or size > self._limits.max_send_buffer:
            return bytes(self.message_to_binary(body, request_id=request_id))
        self._sequence_number = self._sequence_number % _MAX_SEQUENCE + 1
        token = self.security_token
        numbers = (token.ChannelId, token.TokenId, self._sequence_number, request_id)
        return _PLAIN.pack(b"MSG", b"F", size, *numbers) + body

    def _check_incoming_chunk(self, chunk: Any) -> None:
        is_open = chunk.MessageHeader.MessageType == ua.MessageType.SecureOpen
        if (
            not is_open
            and chunk.MessageHeader.ChannelId != self.security_token.ChannelId
        ):
            raise TransportError(_Codes.BadSecureChannelIdInvalid, "another channel")
        number = chunk.SequenceHeader.SequenceNumber
        last = self._peer_sequence_number
        expected = number if last is None else last + 1
        if number != expected and not (
            number < _WRAP and expected > _MAX_SEQUENCE - _WRAP
        ):
            raise TransportError(_Codes.BadSequenceNumberInvalid, "out of order")
        super()._check_incoming_chunk(chunk)

    def _has_expired(self) -> bool:
        token = self.security_token
        if token.TokenId != self._expiring[0]:
            lifetime = timedelta(milliseconds=token.RevisedLifetime * 1.25)
            self._expiring = (token.TokenId, (token.CreatedAt + lifetime).timestamp())
        return time.time() > self._expiring[1]

    def _check_sym_header(self, security_hdr: ua.SymmetricAlgorithmHeader) -> None:
        if security_hdr.TokenId == 0:
            # asyncua would take it for the token of a renewal that was not requested.
            raise TransportError(_Codes.BadSecureChannelTokenUnknown, "no such token")
        try:
            super()._check_sym_header(security_hdr)
        except ua.UaError:
            raise TransportError(
                _Codes.BadSecureChannelTokenUnknown, "no such token"
            ) from None
        if self._has_expired():
            raise TransportError(
                _Codes.BadSecureChannelTokenUnknown, "the channel has expired"
            )

    def _receive(self, msg: Any) -> ua.Message | None:
        if (
            msg.MessageHeader.ChunkType == ua.ChunkType.Abort
            and not self._incoming_parts
        ):
            raise TransportError(_Codes.BadTcpMessageTypeInvalid, "nothing to abort")
        self._limits.max_message_size = self.max_bytes
        self._limits.max_chunk_count = max(1, self.max_bytes // _MIN_CHUNK_BYTES)
        return super()._receive(msg)
