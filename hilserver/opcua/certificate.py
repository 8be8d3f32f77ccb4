"""Application instance certificates: made, loaded, described (OPC 10000-6, 6.2.2)."""

import hashlib
import ipaddress
from collections.abc import Iterable, Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from hilserver.small_file import read_small

KEY_BITS = 2048
MAX_CERTIFICATE_BYTES = 16 * 1024


def make_key(bits: int = KEY_BITS) -> rsa.RSAPrivateKey:
    """Return a new RSA key."""
    return rsa.generate_private_key(public_exponent=65537, key_size=bits)


def _extensions(
    names: list[x509.GeneralName],
    usage: x509.KeyUsage,
    public: rsa.RSAPublicKey,
    signer: rsa.RSAPrivateKey,
) -> list[tuple[x509.ExtensionType, bool]]:
    """Return the extensions of a certificate, and whether each is critical."""
    uses = [ExtendedKeyUsageOID.SERVER_AUTH, ExtendedKeyUsageOID.CLIENT_AUTH]
    of_signer = signer.public_key()
    return [
        (x509.SubjectAlternativeName(names), False),
        (x509.BasicConstraints(ca=False, path_length=None), True),
        (usage, True),
        (x509.ExtendedKeyUsage(uses), False),
        (x509.SubjectKeyIdentifier.from_public_key(public), False),
        (x509.AuthorityKeyIdentifier.from_issuer_public_key(of_signer), False),
    ]


def make_certificate(
    key: rsa.RSAPrivateKey,
    application_uri: str,
    hosts: Iterable[str],
    *,
    common_name: str = "hilserver",
    days: float = 730,
    not_before: datetime | None = None,
    issuer: tuple[x509.Certificate, rsa.RSAPrivateKey] | None = None,
) -> x509.Certificate:
    """Return an application certificate, self-signed unless an issuer is given.

    Parameters
    ----------
    application_uri : str
        Goes into the SubjectAlternativeName; must equal the URI that the application announces.
    hosts : iterable of str
        Host names and addresses by which clients reach the server.
    days : float
        Validity from `not_before` on, which is now by default.
    """
    begin = not_before or datetime.now(UTC) - timedelta(minutes=5)
    common = x509.NameAttribute(NameOID.COMMON_NAME, common_name[:64])
    organization = x509.NameAttribute(NameOID.ORGANIZATION_NAME, "hilserver")
    subject = x509.Name([common, organization])
    issued_by = subject if issuer is None else issuer[0].subject
    public = key.public_key()
    signer = key if issuer is None else issuer[1]
    names = [
        x509.UniformResourceIdentifier(application_uri),
        *map(_general_name, hosts),
    ]
    usage = _key_usage(issuer is None)
    builder = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issued_by)
        .public_key(public)
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(begin + timedelta(days=days))
    )
    for extension, is_critical in _extensions(names, usage, public, signer):
        builder = builder.add_extension(extension, is_critical)
    return builder.sign(signer, hashes.SHA256())


def _key_usage(is_self_signed: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=True,
        key_encipherment=True,
        data_encipherment=True,
        key_agreement=False,
        key_cert_sign=is_self_signed,
        crl_sign=False,
        encipher_only=False,
        decipher_only=False,
    )


def _general_name(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def parse_certificate(data: bytes) -> x509.Certificate:
    """Return the certificate in PEM or DER bytes, the first of a chain.

    ValueError if there is none.
    """
    if len(data) > MAX_CERTIFICATE_BYTES:
        raise ValueError("larger than a certificate may be")
    if data.lstrip().startswith(b"-----BEGIN"):
        return x509.load_pem_x509_certificate(data)
    return x509.load_der_x509_certificate(first_of_chain(data))


def first_of_chain(data: bytes) -> bytes:
    """Return the first DER certificate of several written one after the other."""
    if len(data) < 4 or data[0] != 0x30:
        raise ValueError("not a DER certificate")
    length = data[1]
    head = 2
    if length & 0x80:
        head += length & 0x7F
        length = int.from_bytes(data[2:head], "big")
    return data[: head + length]


def load_certificate(path: Path) -> x509.Certificate:
    """Read a certificate file; ValueError or OSError if that fails."""
    return parse_certificate(read_small(path, MAX_CERTIFICATE_BYTES))


def to_der(certificate: x509.Certificate) -> bytes:
    """Return the bytes that are sent in OPC UA."""
    return certificate.public_bytes(serialization.Encoding.DER)


def thumbprint(certificate: x509.Certificate) -> str:
    """Return the SHA-1 thumbprint, by which OPC UA names certificates, in hexadecimal."""
    return hashlib.sha1(to_der(certificate), usedforsecurity=False).hexdigest().upper()


def application_uris(certificate: x509.Certificate) -> Sequence[str]:
    """Return the URIs of the SubjectAlternativeName."""
    return _alternative_names(certificate, x509.UniformResourceIdentifier)


def host_names(certificate: x509.Certificate) -> Sequence[str]:
    """Return host names and addresses of the SubjectAlternativeName."""
    addresses = _alternative_names(certificate, x509.IPAddress)
    return [*_alternative_names(certificate, x509.DNSName), *map(str, addresses)]


def _alternative_names(certificate: x509.Certificate, kind: type) -> list[str]:
    try:
        names = certificate.extensions.get_extension_for_class(
            x509.SubjectAlternativeName
        ).value
    except (x509.ExtensionNotFound, ValueError):
        return []
    return list(names.get_values_for_type(kind))


def common_name(certificate: x509.Certificate) -> str:
    """Return the common name of the subject, empty without one."""
    names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(names[0].value) if names else ""


def key_to_pem(key: rsa.RSAPrivateKey) -> bytes:
    """Return the key as PKCS #8; the file that holds it must be 0600."""
    return key.private_bytes(
        serialization.Encoding.PEM,
        serialization.PrivateFormat.PKCS8,
        serialization.NoEncryption(),
    )


def parse_key(data: bytes) -> rsa.RSAPrivateKey:
    """Return the RSA key in PEM bytes; ValueError if there is none."""
    try:
        key = serialization.load_pem_private_key(data, password=None)
    except TypeError:
        raise ValueError(
            "the key has a password; store it without, readable by you only"
        ) from None
    except ValueError:
        raise ValueError("not a private key in PEM form") from None
    if not isinstance(key, rsa.RSAPrivateKey):
        raise ValueError("not an RSA key")
    return key
