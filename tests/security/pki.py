"""Keys and certificates for the tests, made once: RSA keys take their time."""

from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from asyncua import Client
from asyncua.crypto import security_policies
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.x509.oid import NameOID

from hilserver.opcua.certificate import (
    key_to_pem,
    make_certificate,
    make_key,
    to_der,
)
from hilserver.opcua.passwords import hash_password
from hilserver.opcua.settings import default_application_uri
from hilserver.opcua.trust_list import TrustList, write_private

POLICIES = ("Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss")
PASSWORDS = {"olga": "see", "otto": "drive", "emma": "all"}
ROLES = {"olga": "observer", "otto": "operator", "emma": "engineer"}
CLIENT_URI = "urn:tests:client"


@dataclass
class Identity:
    """Certificate and key of one application, in files."""

    uri: str
    certificate: x509.Certificate
    key: Any
    folder: Path

    @property
    def certificate_path(self) -> Path:
        return self.folder / "certificate.der"

    @property
    def key_path(self) -> Path:
        return self.folder / "key.pem"

    @property
    def der(self) -> bytes:
        return to_der(self.certificate)


class Pki:
    """A folder of certificates for the server, and clients of every kind."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.trust = TrustList(folder / "server")
        self.trust.make_folders()
        self._keys = [make_key() for _ in range(2)]
        self.server = self._store(
            "server/own",
            default_application_uri(),
            self._keys[0],
            ["127.0.0.1", "localhost"],
        )
        self.client = self.identity("client")
        self.trust_it(self.client)

    def _store(
        self, name: str, uri: str, key: Any, hosts: Any = (), **more: Any
    ) -> Identity:
        folder = self.folder / name
        folder.mkdir(parents=True, exist_ok=True)
        certificate = make_certificate(key, uri, hosts, common_name=name[-20:], **more)
        identity = Identity(uri, certificate, key, folder)
        write_private(identity.certificate_path, to_der(certificate))
        write_private(identity.key_path, key_to_pem(key))
        return identity

    def identity(self, name: str, uri: str = CLIENT_URI, **more: Any) -> Identity:
        return self._store(name, uri, self._keys[1], ["127.0.0.1"], **more)

    def trust_it(self, identity: Identity) -> None:
        self._put("trusted", identity)

    def revoke(self, identity: Identity) -> None:
        self._put("revoked", identity)

    def _put(self, folder: str, identity: Identity) -> None:
        path = self.trust.folder / folder / f"{identity.folder.name}.der"
        write_private(path, identity.der)

    def authority(self) -> tuple[x509.Certificate, Any]:
        key = self._keys[0]
        name = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "plant authority")])
        now = datetime.now(UTC)
        certificate = (
            x509.CertificateBuilder()
            .subject_name(name)
            .issuer_name(name)
            .public_key(key.public_key())
            .serial_number(7)
            .not_valid_before(now - timedelta(days=1))
            .not_valid_after(now + timedelta(days=30))
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .sign(key, hashes.SHA256())
        )
        write_private(
            self.trust.folder / "trusted" / "authority.der", to_der(certificate)
        )
        return certificate, key

    def config(self) -> dict[str, Any]:
        """Return the keys of ``opcua:`` that make a secure server."""
        return {
            "policies": POLICIES,
            "certificates": self.trust.folder,
            "users": [
                {"name": n, "password": hash_password(p, log_n=10), "role": ROLES[n]}
                for n, p in PASSWORDS.items()
            ],
        }

    async def secure(
        self,
        client: Client,
        user: str | None = "emma",
        policy: str = "Basic256Sha256",
        identity: Identity | None = None,
        password: str | None = None,
    ) -> Client:
        """Make a client use a policy, a certificate and a user."""
        identity = identity or self.client
        client.application_uri = identity.uri
        await client.set_security(
            getattr(security_policies, f"SecurityPolicy{policy}"),
            certificate=str(identity.certificate_path),
            private_key=str(identity.key_path),
            server_certificate=str(self.server.certificate_path),
        )
        if user is not None:
            client.set_user(user)
            client.set_password(
                PASSWORDS.get(user, "x") if password is None else password
            )
        return client
