"""The folder of certificates: ``own``, ``trusted``, ``rejected`` and ``revoked``.

======== =======================================================================================
own      certificate.der and key.pem (0600)
trusted  certificates of clients that may connect and of servers (``peers:``) that we connect to,
         or of authorities that issued theirs
rejected certificates of untrusted clients that tried to connect, and of servers; `hilserver
         certs trust` moves them
revoked  certificates that are refused whatever ``trusted`` contains, and revocation lists (CRL)
         of trusted authorities
======== =======================================================================================

A change in a folder takes effect at the next connection, without a restart. While a file in
``revoked`` cannot be read no client is admitted: it may revoke any certificate.
"""

import errno
import ipaddress
import os
import re
import time
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime
from enum import StrEnum
from pathlib import Path

from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, SignatureAlgorithmOID

from hilserver.errors import ConfigError, FailedError
from hilserver.opcua.certificate import (
    application_uris,
    common_name,
    host_names,
    load_certificate,
    parse_certificate,
    parse_key,
    thumbprint,
    to_der,
)
from hilserver.opcua.logs import log
from hilserver.opcua.passwords import FailedAttempts
from hilserver.small_file import read_small, sync_folder

MAX_REJECTED = 100
KEPT_AT_ONCE, KEPT_WITHIN_S = 10, 60.0
"""Limit of rejected certificates kept per address and time, as each is written to disk."""
MAX_LIST_BYTES = 64_000_000
FOLDERS = ("own", "trusted", "rejected", "revoked")
_SHA2 = {
    SignatureAlgorithmOID.RSA_WITH_SHA256,
    SignatureAlgorithmOID.RSA_WITH_SHA384,
    SignatureAlgorithmOID.RSA_WITH_SHA512,
}
_SUFFIXES = {".der", ".pem", ".crt", ".cer", ".crl"}
_MIN_KEY_BITS, _MAX_KEY_BITS = 2048, 4096


class CertificateVerdict(StrEnum):
    """What is wrong with a certificate; the values are names of OPC UA status codes."""

    GOOD = "Good"
    INVALID = "BadCertificateInvalid"
    UNTRUSTED = "BadCertificateUntrusted"
    POLICY = "BadCertificatePolicyCheckFailed"
    TIME = "BadCertificateTimeInvalid"
    ISSUER_TIME = "BadCertificateIssuerTimeInvalid"
    USE = "BadCertificateUseNotAllowed"
    REVOKED = "BadCertificateRevoked"
    REVOCATION_UNKNOWN = "BadCertificateRevocationUnknown"
    HOST = "BadCertificateHostNameInvalid"
    URI = "BadCertificateUriInvalid"


@dataclass
class _Folder:
    """Certificates and revocation lists of one folder, read again when a file of it changes."""

    path: Path
    effect: str  # of a file that cannot be read
    stamp: dict[Path, tuple[int, ...] | None] = field(default_factory=dict)
    # files that cannot be read, and why
    unread: dict[Path, str] = field(default_factory=dict)
    certificates: dict[str, x509.Certificate] = field(default_factory=dict)
    lists: list[x509.CertificateRevocationList] = field(default_factory=list)

    def refresh(self) -> "_Folder":
        try:
            stamp = {path: _stamp(path) for path in files_in(self.path)}
        except OSError:
            stamp = {self.path: ()}  # not a readable file either
        if stamp != self.stamp:
            self._read(stamp)
        return self

    def _read(self, stamp: dict[Path, tuple[int, ...]]) -> None:
        before = self.unread
        self.unread = {}
        self.stamp = {**stamp}
        self.certificates = {}
        self.lists = []
        for path in stamp:
            try:
                data = read_small(path, MAX_LIST_BYTES)
                try:
                    certificate = parse_certificate(data)
                except ValueError:
                    is_text = data[:1000].lstrip().startswith(b"-----BEGIN")
                    if is_text:
                        parsed = x509.load_pem_x509_crl(data)
                    else:
                        parsed = x509.load_der_x509_crl(data)
                    self.lists.append(parsed)
                else:
                    self.certificates[thumbprint(certificate)] = certificate
            except (ValueError, OSError) as error:
                why = self.unread[path] = getattr(error, "strerror", None) or str(error)
                if isinstance(error, OSError) and error.errno != errno.EFBIG:
                    # equals no stamp: the error may pass, so read again
                    self.stamp[path] = None
                if why != before.get(path):
                    log.error(
                        f"{self.effect}: replace or remove this file",
                        file=str(path),
                        reason=why,
                    )


def _stamp(path: Path) -> tuple[int, ...]:
    """Return numbers that change with a file; none if it is gone."""
    try:
        found = path.stat()
    except OSError:
        return ()
    return found.st_ctime_ns, found.st_ino, found.st_size


def files_in(folder: Path) -> Iterator[Path]:
    """Return the certificate files of a folder, sorted by name."""
    if folder.is_dir():
        yield from sorted(p for p in folder.iterdir() if p.suffix.lower() in _SUFFIXES)


class TrustList:
    """Judges the certificates of peers."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        # trusted as a client like those in the folder: the operator page shows it
        self.ours: x509.Certificate | None = None
        self._trusted = _Folder(folder / "trusted", "it makes nobody trusted")
        self._revoked = _Folder(folder / "revoked", "nobody is admitted")
        self._kept = FailedAttempts(KEPT_AT_ONCE, KEPT_WITHIN_S)

    def make_folders(self) -> None:
        """Make the folders, readable by their owner only; FailedError if that fails."""
        try:
            for name in FOLDERS:
                (self.folder / name).mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise FailedError(f"{error.filename}: {error.strerror}") from None

    def _known(
        self, use: x509.ObjectIdentifier, only: x509.Certificate | None
    ) -> Mapping[str, x509.Certificate]:
        """Return the certificates by which a peer is trusted: its own, or an authority's."""
        known = self._trusted.refresh().certificates
        if only is not None:
            known = {thumbprint(only): only}
        if self.ours is not None and use == ExtendedKeyUsageOID.CLIENT_AUTH:
            known = {**known, thumbprint(self.ours): self.ours}
        return known

    def judge(
        self,
        data: bytes,
        now: datetime | None = None,
        *,
        use: x509.ObjectIdentifier = ExtendedKeyUsageOID.CLIENT_AUTH,
        only: x509.Certificate | None = None,
    ) -> CertificateVerdict:
        """Judge the certificate (DER) of a peer, in the order of OPC 10000-4, 6.1.3.

        The application URI is not known at this point; the session compares it.

        Parameters
        ----------
        use : x509.ObjectIdentifier
            What the peer does with its key.
        only : x509.Certificate or None
            Replaces the folder ``trusted``.
        """
        try:
            certificate = parse_certificate(data)
            key = certificate.public_key()
            _ = certificate.extensions
        except (ValueError, TypeError):
            return CertificateVerdict.INVALID
        now = now or datetime.now(UTC)
        known = self._known(use, only)
        revoked = self._revoked.refresh()
        own = thumbprint(certificate)
        if own in revoked.certificates:
            return CertificateVerdict.REVOKED
        issuer = None
        if own not in known:
            issuer = _issuer_of(certificate, known.values())
            if issuer is None:
                return CertificateVerdict.UNTRUSTED
        if not isinstance(key, rsa.RSAPublicKey) or not _is_strong(certificate, key):
            return CertificateVerdict.POLICY
        if not _is_in_time(certificate, now):
            return CertificateVerdict.TIME
        if issuer and not _is_in_time(issuer, now):
            return CertificateVerdict.ISSUER_TIME
        if not _may_authenticate(certificate, use):
            return CertificateVerdict.USE
        if issuer and _is_on_a_list(certificate, issuer, revoked.lists):
            return CertificateVerdict.REVOKED
        if revoked.unread:
            return CertificateVerdict.REVOCATION_UNKNOWN
        return CertificateVerdict.GOOD

    def judge_server(
        self,
        data: bytes,
        host: str,
        application_uri: str,
        now: datetime | None = None,
        *,
        only: x509.Certificate | None = None,
    ) -> CertificateVerdict:
        """Judge the certificate of a server that we connect to; the host is the client's check."""
        verdict = self.judge(data, now, use=ExtendedKeyUsageOID.SERVER_AUTH, only=only)
        if verdict is not CertificateVerdict.GOOD:
            return verdict
        certificate = parse_certificate(data)
        if _plain_host(host) not in map(_plain_host, host_names(certificate)):
            return CertificateVerdict.HOST
        if application_uri not in application_uris(certificate):
            return CertificateVerdict.URI
        return CertificateVerdict.GOOD

    def has_kept_many(self, address: str) -> bool:
        """Whether `KEPT_AT_ONCE` certificates of an address were kept recently."""
        return self._kept.is_blocked(address, time.monotonic())

    def keep_rejected(self, data: bytes, address: str = "") -> Path | None:
        """Put a refused certificate into ``rejected``; the oldest make room.

        None if that fails, or others of this address fill its share: see `has_kept_many`.

        Parameters
        ----------
        address : str
            Address of a client; empty for a server that we connect to.
        """
        try:
            certificate = parse_certificate(data)
            folder = self.folder / "rejected"
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            path = folder / file_name(certificate)
            if path.exists():
                return path
            if address:
                if self.has_kept_many(address):
                    return None
                self._kept.failed(address, time.monotonic())
            kept = sorted(files_in(folder), key=lambda p: p.stat().st_mtime_ns)
            for old in kept[: max(0, len(kept) - MAX_REJECTED + 1)]:
                old.unlink(missing_ok=True)
            write_private(path, to_der(certificate))
        except (ValueError, OSError):
            return None
        return path

    def own(
        self, private_key: Path | None = None, certificate_path: Path | None = None
    ) -> tuple[x509.Certificate, rsa.RSAPrivateKey]:
        """Return our certificate and key, by default those of the folder.

        ConfigError if a file is missing or wrong, or other users can read the key.
        """
        certificate_path = certificate_path or self.folder / "own" / "certificate.der"
        key_path = private_key or self.folder / "own" / "key.pem"
        path = certificate_path
        try:
            certificate = load_certificate(path)
            path = key_path
            is_exposed = is_open_to_others(path)
            key = parse_key(read_small(path))
        except FileNotFoundError:
            raise ConfigError(
                f"{path} is missing: make a certificate with 'hilserver certs make'"
            ) from None
        except OSError as error:
            raise ConfigError(f"{path} cannot be read: {error.strerror}") from None
        except ValueError as error:
            raise ConfigError(f"{path} cannot be used: {error}") from None
        if is_exposed:
            raise ConfigError(f"{path} can be read by others: run 'chmod 600 {path}'")
        if certificate.public_key() != key.public_key():
            raise ConfigError(
                f"{certificate_path} does not belong to the key {key_path}"
            )
        return certificate, key


def file_name(certificate: x509.Certificate) -> str:
    """Return the name under which a certificate is stored: common name and thumbprint."""
    readable = re.sub(r"[^A-Za-z0-9._-]+", "_", common_name(certificate))[:40].strip(
        "._"
    )
    return f"{readable or 'unnamed'}-{thumbprint(certificate)}.der"


def is_open_to_others(path: Path) -> bool:
    """Whether users other than its owner can read a file; OSError if it cannot be examined.

    A credential of systemd lies in a private folder of the service, whatever the file's mode bits
    (with an access list they show its mask).
    """
    credentials = os.environ.get("CREDENTIALS_DIRECTORY")
    if credentials and path.resolve().parent == Path(credentials).resolve():
        return False
    return bool(path.stat().st_mode & 0o077)


def write_private(path: Path, data: bytes) -> None:
    """Write a file that only its owner can read, whole or not at all.

    Once this returns, the disk holds it under its name.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}")
    try:
        descriptor = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_TRUNC, 0o600)
        with os.fdopen(descriptor, "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
    sync_folder(path.parent)


def _is_in_time(certificate: x509.Certificate, now: datetime) -> bool:
    begin = certificate.not_valid_before_utc
    return begin <= now <= certificate.not_valid_after_utc


def _issuer_of(
    certificate: x509.Certificate, candidates: Iterable[x509.Certificate]
) -> x509.Certificate | None:
    for candidate in candidates:
        if not _is_authority(candidate):
            continue
        try:
            certificate.verify_directly_issued_by(candidate)
        except (ValueError, TypeError, InvalidSignature):
            continue
        return candidate
    return None


def _is_authority(certificate: x509.Certificate) -> bool:
    try:
        return certificate.extensions.get_extension_for_class(
            x509.BasicConstraints
        ).value.ca
    except (x509.ExtensionNotFound, ValueError):
        return False


def _is_strong(certificate: x509.Certificate, key: rsa.RSAPublicKey) -> bool:
    return (
        _MIN_KEY_BITS <= key.key_size <= _MAX_KEY_BITS
        and certificate.signature_algorithm_oid in _SHA2
    )


def _plain_host(host: str) -> str:
    try:
        return str(ipaddress.ip_address(host))
    except ValueError:
        return host.lower().removesuffix(".")


def _may_authenticate(
    certificate: x509.Certificate, use: x509.ObjectIdentifier
) -> bool:
    """Whether the extensions allow this use of the key; absent ones forbid nothing."""
    for extension in certificate.extensions:
        value = extension.value
        if isinstance(value, x509.KeyUsage) and not (
            value.digital_signature
            and (value.key_encipherment or value.data_encipherment)
        ):
            return False
        if isinstance(value, x509.ExtendedKeyUsage) and use not in value:
            return False
    return True


def _is_on_a_list(
    certificate: x509.Certificate,
    issuer: x509.Certificate,
    lists: list[x509.CertificateRevocationList],
) -> bool:
    key = issuer.public_key()
    assert isinstance(key, rsa.RSAPublicKey)
    return any(
        revocations.issuer == issuer.subject
        and revocations.is_signature_valid(key)
        and revocations.get_revoked_certificate_by_serial_number(
            certificate.serial_number
        )
        is not None
        for revocations in lists
    )
