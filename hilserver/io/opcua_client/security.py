"""Protects the link to a peer: its certificate is judged before anything secret is sent.

An attempt has three steps. The endpoints are requested without protection, as they are not
secret. The certificate of the endpoint with exactly our policy and mode is judged. Only then a
channel is opened, in which only the owner of that certificate's key can answer, and the user's
password is sent through it. There is no fallback to another policy.
"""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import structlog
from asyncua import Client, ua
from asyncua.crypto import security_policies
from cryptography import x509
from cryptography.hazmat.primitives.asymmetric import rsa

from hilserver.config.peers import PeerConfig
from hilserver.errors import ConfigError
from hilserver.io.opcua_client import refusal
from hilserver.io.peer_link.samples import FaultKind, LinkRefusedError
from hilserver.opcua.certificate import (
    application_uris,
    first_of_chain,
    load_certificate,
    thumbprint,
    to_der,
)
from hilserver.opcua.passwords import MAX_PASSWORD_BYTES
from hilserver.opcua.settings import OpcUaSettings
from hilserver.opcua.trust_list import CertificateVerdict, TrustList, is_open_to_others

_POLICIES: dict[str, Any] = {
    "Basic256Sha256": security_policies.SecurityPolicyBasic256Sha256,
    "Aes128Sha256RsaOaep": security_policies.SecurityPolicyAes128Sha256RsaOaep,
    "Aes256Sha256RsaPss": security_policies.SecurityPolicyAes256Sha256RsaPss,
}
_NONE_URI = security_policies.SecurityPolicyNone.URI
_NAMES = {_NONE_URI: "None", **{policy.URI: name for name, policy in _POLICIES.items()}}
_MODES = {
    "sign": ua.MessageSecurityMode.Sign,
    "sign_and_encrypt": ua.MessageSecurityMode.SignAndEncrypt,
}
_WARN_BEFORE = timedelta(days=30)
_TAKEN_AWAY = {CertificateVerdict.UNTRUSTED, CertificateVerdict.REVOKED}

_log = structlog.get_logger(__name__)


@dataclass(frozen=True)
class _Identity:
    """Certificate and keys of a secure link."""

    policy: Any
    mode: ua.MessageSecurityMode
    certificate: x509.Certificate
    key: rsa.RSAPrivateKey
    trust: TrustList
    only: x509.Certificate | None
    trust_with: str


class LinkSecurity:
    """Protects the sessions of one peer.

    ConfigError if a file is missing, cannot be used, or can be read by others.

    Parameters
    ----------
    opcua : OpcUaSettings
        Has the certificates if the peer's configuration does not.
    folder : Path
        Folder that relative paths start from.
    """

    def __init__(self, config: PeerConfig, opcua: OpcUaSettings, folder: Path) -> None:
        security = config.security
        self._host = security.peer_host or config.host
        self._wanted = f"{security.policy} and {security.effective_mode}"
        self.user = security.user
        self._password_file = security.password_file and folder / security.password_file
        self._shown: tuple[bytes, str] | None = None
        self._identity: _Identity | None = None
        try:
            if security.is_secure:
                self._identity = _identity(config, opcua, folder)
            if self._password_file is not None:
                _read_password(self._password_file)
        except ConfigError as error:
            raise ConfigError(f"peer '{config.name}': {error}") from None

    @property
    def thumbprint(self) -> str:
        """Thumbprint of our certificate, empty without one."""
        return "" if self._identity is None else thumbprint(self._identity.certificate)

    async def prepare(
        self,
        client: "PeerClient",
        ask: Callable[[], Awaitable[list[ua.EndpointDescription]]],
    ) -> None:
        """Give `client` everything it needs to connect to a trusted peer.

        `ask`: returns the endpoints of the peer. RefusedError if the peer does not offer our
        policy, or its certificate is not good.
        """
        identity = self._identity
        if identity is not None:
            endpoint = self._choose(await ask())
            certificate = self._judged(endpoint.ServerCertificate, endpoint.Server)
            client.application_uri = application_uris(identity.certificate)[0]
            client.security_policy = identity.policy(
                certificate, identity.certificate, identity.key, identity.mode
            )
            client.uaclient.set_security(client.security_policy)
            client.certificate_validator = self._judge_session
        if self.user is not None and self._password_file is not None:
            try:
                password = _read_password(self._password_file)
            except ConfigError as error:
                raise LinkRefusedError(
                    FaultKind.LOG_IN, "file", f"not connected: {error}"
                ) from None
            client.set_user(self.user)
            client.set_password(password)

    def check_again(self) -> None:
        """Raise RefusedError if the connected peer is no longer trusted."""
        if self._shown is None or self._identity is None:
            return
        verdict = self._verdict(*self._shown)
        if verdict in _TAKEN_AWAY:
            raise self._refuse(verdict, *self._shown)

    def choose_token(
        self, offered: list[ua.UserTokenPolicy], token_type: ua.UserTokenType
    ) -> ua.UserTokenPolicy:
        """Return the token policy for the log-in: no weaker for the password than the channel is.

        RefusedError if there is none.
        """
        identity = self._identity
        assert identity is not None
        fitting = [p for p in offered if p.TokenType == token_type]
        if not fitting:
            raise refusal.token_missing(self.user, offered)
        if token_type != ua.UserTokenType.UserName:
            return fitting[0]
        known = {policy.URI for policy in _POLICIES.values()}
        encrypted = [
            p for p in fitting if (p.SecurityPolicyUri or identity.policy.URI) in known
        ]
        if encrypted:
            own = [
                p
                for p in encrypted
                if p.SecurityPolicyUri in (None, "", identity.policy.URI)
            ]
            return (own or encrypted)[0]
        plain = [p for p in fitting if p.SecurityPolicyUri == _NONE_URI]
        if plain and identity.mode == ua.MessageSecurityMode.SignAndEncrypt:
            return plain[0]
        uri = fitting[0].SecurityPolicyUri
        raise refusal.password_exposed("" if uri == _NONE_URI else uri or "")

    def _choose(
        self, endpoints: list[ua.EndpointDescription]
    ) -> ua.EndpointDescription:
        identity = self._identity
        assert identity is not None
        for endpoint in endpoints:
            has_policy = endpoint.SecurityPolicyUri == identity.policy.URI
            if (
                has_policy
                and endpoint.SecurityMode == identity.mode
                and (endpoint.EndpointUrl or "").startswith("opc.tcp:")
            ):
                return endpoint
        raise refusal.policy_missing(self._wanted, endpoints, _NAMES)

    async def _judge_session(
        self, certificate: x509.Certificate, server: ua.ApplicationDescription
    ) -> None:
        """Judge again how the peer identifies itself, now through the secure channel."""
        self._judged(to_der(certificate), server)

    def _judged(
        self, data: bytes | None, server: ua.ApplicationDescription
    ) -> x509.Certificate:
        """Return the certificate if it is good."""
        assert self._identity is not None
        shown = data or b""
        uri = server.ApplicationUri or ""
        verdict = self._verdict(shown, uri)
        if verdict is not CertificateVerdict.GOOD:
            kept = (
                verdict is CertificateVerdict.UNTRUSTED
                and self._identity.trust.keep_rejected(shown)
            )
            raise self._refuse(verdict, shown, uri, is_kept=kept is not None)
        self._shown = (shown, uri)
        return x509.load_der_x509_certificate(first_of_chain(shown))

    def _verdict(self, data: bytes, uri: str) -> CertificateVerdict:
        assert self._identity is not None
        trust = self._identity.trust
        only = self._identity.only
        return trust.judge_server(data, self._host, uri, only=only)

    def _refuse(
        self,
        verdict: CertificateVerdict,
        data: bytes,
        uri: str,
        *,
        is_kept: bool = True,
    ) -> LinkRefusedError:
        identity = self._identity
        assert identity is not None
        if is_kept:
            remedy = identity.trust_with
        else:
            remedy = f"put it into {identity.trust.folder}/trusted"
        return refusal.certificate_refused(verdict, data, self._host, uri, remedy)


class PeerClient(Client):  # type: ignore[misc]
    """asyncua's client that leaves the choice of the token to the link's security."""

    security: LinkSecurity | None = None

    def server_policy(self, token_type: ua.UserTokenType) -> ua.UserTokenPolicy:
        """Return the policy of the user's token; asyncua would accept any, even in clear text."""
        if self.security is None or self.security_policy.URI == _NONE_URI:
            return super().server_policy(token_type)
        chosen = self.security.choose_token(self._policy_ids, token_type)
        if chosen.SecurityPolicyUri:
            return chosen
        return ua.UserTokenPolicy(
            PolicyId=chosen.PolicyId,
            TokenType=token_type,
            SecurityPolicyUri=self.security_policy.URI,
        )


def _identity(config: PeerConfig, opcua: OpcUaSettings, folder: Path) -> _Identity:
    security = config.security
    ours = TrustList(folder / opcua.certificates)
    key_path = security.private_key or opcua.private_key
    key_file = key_path and folder / key_path
    certificate_file = security.certificate and folder / security.certificate
    certificate, key = ours.own(key_file, certificate_file)
    if not application_uris(certificate):
        raise ConfigError(
            "our certificate names no application URI: make a new one with 'hilserver certs make'"
        )
    left = certificate.not_valid_after_utc - datetime.now(UTC)
    if left < _WARN_BEFORE:
        remedy = "run 'hilserver certs renew'"
        _log.warning(
            "certificate ends", peer=config.name, days_left=left.days, remedy=remedy
        )
    trust = ours if security.trust is None else TrustList(folder / security.trust)
    option = "" if security.trust is None else f" --folder {security.trust}"
    trust_with = f"compare it, then 'hilserver certs trust{option} THUMBPRINT'"
    only = None
    if security.peer_certificate is not None:
        only = _load(folder / security.peer_certificate)
        trust_with = "it is not the one in peer_certificate"
    return _Identity(
        _POLICIES[security.policy],
        _MODES[security.effective_mode],
        certificate,
        key,
        trust,
        only,
        trust_with,
    )


def _load(path: Path) -> x509.Certificate:
    try:
        return load_certificate(path)
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path} is not a certificate: {error}") from None


def _read_password(path: Path) -> str:
    """Return the first line of a file; others must not be able to read it."""
    try:
        if is_open_to_others(path):
            raise ConfigError(f"{path} can be read by others: run 'chmod 600 {path}'")
        with path.open("rb") as file:
            password = (
                file.read(MAX_PASSWORD_BYTES + 2).split(b"\n")[0].rstrip(b"\r").decode()
            )
    except OSError as error:
        raise ConfigError(
            f"password_file {path} cannot be read: {error.strerror}"
        ) from None
    except ValueError:
        raise ConfigError(f"password_file {path} contains no text") from None
    if not 0 < len(password.encode()) <= MAX_PASSWORD_BYTES:
        raise ConfigError(
            f"password_file {path}: its first line must be a password of up to"
            f" {MAX_PASSWORD_BYTES} bytes"
        )
    return password
