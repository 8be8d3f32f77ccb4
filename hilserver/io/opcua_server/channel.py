"""The secure channel of one connection: asyncua's, without the ways around it.

asyncua falls back to policy None whatever the server is set to, answers messages that no
OpenSecureChannel came before, and lets expired keys live. Here a channel is opened once with a
policy that is offered and a certificate that is trusted; policy None that is not offered carries
discovery and nothing else.
"""

import hashlib
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from typing import Any

from asyncua import ua
from asyncua.common.connection import SecureConnection, TransportLimits
from asyncua.crypto.security_policies import SecurityPolicyFactory, SecurityPolicyNone

from hilserver.io.opcua_security.certificate import first_of_chain
from hilserver.io.opcua_security.trust_list import TrustList, Verdict
from hilserver.io.opcua_server.frames import MAX_CHUNK_BYTES, TransportError
from hilserver.io.opcua_server.logs import log

MAX_BYTES_BEFORE_LOGIN = 65_536
MIN_BUFFER_BYTES = 8192
_MIN_LIFETIME_MS, _MAX_LIFETIME_MS = 10_000, 3_600_000
_MIN_CHUNK_BYTES = 4096
_NONCE_BYTES = 32
_MAX_URL_BYTES = 4096
_Codes = ua.StatusCodes
_None = ua.MessageSecurityMode.None_
# OPC 10000-4, 6.1.3: who is not trusted learns no more than that.
_CONCEALED = {Verdict.INVALID, Verdict.UNTRUSTED, Verdict.POLICY}


class GuardedConnection(SecureConnection):  # type: ignore[misc]
    """Encodes, decodes and checks the messages of one connection.

    Parameters
    ----------
    policies : sequence of SecurityPolicyFactory
        What is offered.
    trust : TrustList or None
        Judges certificates; None when only policy None is offered.

    Attributes
    ----------
    is_discovery_only : bool
        The channel is not protected, and the server does not offer that for sessions.
    max_bytes : int
        Longest request that is accepted at this point.
    max_response_bytes : int
        Longest response that the client accepts, 0 for any.
    """

    def __init__(
        self, policies: Sequence[SecurityPolicyFactory], trust: TrustList | None, peer: str
    ) -> None:
        super().__init__(SecurityPolicyNone(), TransportLimits())
        self.set_policy_factories(list(policies))
        self.is_discovery_only = False
        self.max_bytes = MAX_BYTES_BEFORE_LOGIN
        self.max_response_bytes = 0
        self._trust = trust
        self._peer = peer

    def greet(self, hello: ua.Hello, max_bytes: int) -> ua.Acknowledge:
        """Agree on sizes; TransportError if the client's buffers are none."""
        if min(hello.ReceiveBufferSize, hello.SendBufferSize) < MIN_BUFFER_BYTES:
            raise TransportError(_Codes.BadConnectionRejected, "buffers below 8192 bytes")
        if len(hello.EndpointUrl or "") > _MAX_URL_BYTES:
            raise TransportError(_Codes.BadTcpEndpointUrlInvalid, "endpoint URL too long")
        answer = ua.Acknowledge()
        answer.ReceiveBufferSize = min(hello.SendBufferSize, MAX_CHUNK_BYTES)
        answer.SendBufferSize = min(hello.ReceiveBufferSize, MAX_CHUNK_BYTES)
        answer.MaxMessageSize = max_bytes
        answer.MaxChunkCount = max_bytes // _MIN_CHUNK_BYTES
        self._limits.max_send_buffer = answer.SendBufferSize
        self.max_response_bytes = hello.MaxMessageSize
        return answer

    @property
    def has_parts(self) -> bool:
        """Whether a message is still incomplete."""
        return bool(self._incoming_parts)

    def select_policy(
        self, uri: str, peer_certificate: bytes | None, mode: ua.MessageSecurityMode | None = None
    ) -> None:
        """Choose the policy of a new channel; asyncua calls this before and after decrypting."""
        if uri == SecurityPolicyNone.URI:
            self.is_discovery_only = not any(p.matches(uri, _None) for p in self._policies)
            self.security_policy = SecurityPolicyNone()
            if mode not in (None, _None):
                raise TransportError(_Codes.BadSecurityModeRejected, "mode without a policy")
            return
        factory = next((p for p in self._policies if p.matches(uri, mode)), None)
        if factory is None:
            code = (
                _Codes.BadSecurityPolicyRejected
                if mode is None
                else (_Codes.BadSecurityModeRejected)
            )
            raise TransportError(code, "security policy or mode not offered")
        if mode is not None:
            return  # decrypted with this very policy already, and judged
        self._judge(peer_certificate or b"")
        self.security_policy = factory.create(first_of_chain(peer_certificate or b""))

    def _judge(self, certificate: bytes) -> None:
        verdict = Verdict.INVALID if self._trust is None else self._trust.judge(certificate)
        if verdict is Verdict.GOOD:
            return
        kept = None if self._trust is None else self._trust.keep_rejected(certificate)
        log.warning(
            "opcua certificate refused",
            reason=verdict.value,
            address=self._peer,
            kept=None if kept is None else kept.name,
        )
        code = verdict.value if verdict not in _CONCEALED else "BadSecurityChecksFailed"
        raise TransportError(getattr(_Codes, code), "certificate refused")

    def check_asymmetric(self, header: ua.AsymmetricAlgorithmHeader) -> None:
        """Check that an OpenSecureChannel is meant for us and for this channel."""
        policy = self.security_policy
        if header.SecurityPolicyURI != policy.URI:
            raise TransportError(_Codes.BadSecurityChecksFailed, "another policy than the channel")
        if policy.URI == SecurityPolicyNone.URI:
            return
        ours = hashlib.sha1(policy.host_certificate, usedforsecurity=False).digest()
        if header.ReceiverCertificateThumbPrint != ours:
            raise TransportError(_Codes.BadCertificateInvalid, "encrypted for somebody else")
        if first_of_chain(header.SenderCertificate or b"") != policy.peer_certificate:
            raise TransportError(_Codes.BadSecurityChecksFailed, "another certificate")

    def open(self, params: Any, server: Any) -> ua.OpenSecureChannelResult:
        """Open or renew the channel, with a lifetime within bounds."""
        is_issue = params.RequestType == ua.SecurityTokenRequestType.Issue
        if is_issue == self._open:
            raise TransportError(_Codes.BadRequestTypeInvalid, "issue once, then renew")
        is_secure = self.security_policy.Mode != _None
        if params.SecurityMode != self.security_policy.Mode:
            raise TransportError(_Codes.BadSecurityModeRejected, "another mode than the channel")
        if is_secure and len(params.ClientNonce or b"") != _NONCE_BYTES:
            raise TransportError(_Codes.BadNonceInvalid, "the nonce has 32 bytes")
        if self._open and is_secure:
            self._judge(self.security_policy.peer_certificate)
        asked_ms = params.RequestedLifetime or _MAX_LIFETIME_MS
        params.RequestedLifetime = min(max(asked_ms, _MIN_LIFETIME_MS), _MAX_LIFETIME_MS)
        return super().open(params, server)

    def _check_sym_header(self, security_hdr: ua.SymmetricAlgorithmHeader) -> None:
        if security_hdr.TokenId == 0:
            # asyncua would take it for the token of a renewal that nobody asked for.
            raise TransportError(_Codes.BadSecureChannelTokenUnknown, "no such token")
        super()._check_sym_header(security_hdr)
        token = self.security_token
        lifetime = timedelta(milliseconds=token.RevisedLifetime * 1.25)
        if datetime.now(UTC) > token.CreatedAt + lifetime:
            raise TransportError(_Codes.BadSecureChannelTokenUnknown, "the channel has expired")

    def _receive(self, msg: Any) -> ua.Message | None:
        if msg.MessageHeader.ChunkType == ua.ChunkType.Abort and not self._incoming_parts:
            raise TransportError(_Codes.BadTcpMessageTypeInvalid, "nothing to abort")
        self._limits.max_message_size = self.max_bytes
        self._limits.max_chunk_count = max(1, self.max_bytes // _MIN_CHUNK_BYTES)
        return super()._receive(msg)
