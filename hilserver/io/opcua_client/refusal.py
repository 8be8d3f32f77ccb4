"""Why a peer that answers is not connected: for each reason a sentence with the remedy."""

from collections.abc import Iterable, Sequence

from asyncua import ua
from cryptography import x509

from hilserver.io.peer_link.samples import FaultKind, LinkRefusedError
from hilserver.opcua.certificate import (
    host_names,
    parse_certificate,
    thumbprint,
)
from hilserver.opcua.trust_list import CertificateVerdict

_SHOWN = 5
_LONGEST = 100
_LOG_IN_CODES = {
    "BadUserAccessDenied",
    "BadIdentityTokenRejected",
    "BadIdentityTokenInvalid",
}
_POLICY_CODES = {
    "BadSecurityPolicyRejected",
    "BadSecurityModeRejected",
    "BadSecurityModeInsufficient",
}


def certificate_refused(
    verdict: CertificateVerdict,
    data: bytes,
    host: str,
    application_uri: str,
    trust_with: str,
) -> LinkRefusedError:
    """Return what is wrong with the certificate that a peer presents.

    `trust_with`: how to trust the certificate, with ``THUMBPRINT`` for its thumbprint.
    """
    of = CertificateVerdict
    sentences = {
        of.USE: "its certificate may not be used by a server: its key usage forbids it",
        of.REVOKED: "its certificate is revoked",
        of.REVOCATION_UNKNOWN: "its certificate may be revoked: a file in 'revoked' cannot be"
        " read; replace or remove it, the log names it",
        of.POLICY: "its certificate is too weak: RSA 2048 to 4096 bits and SHA-256 are needed",
        of.ISSUER_TIME: "the certificate of its authority is not valid now",
        of.URI: f"it announces the application URI {_quoted(application_uri)}, which its"
        " certificate does not name: issue that certificate again",
    }
    sentence = sentences.get(verdict)
    if verdict is of.INVALID:
        sentence = "it presents no readable certificate"
    if sentence is None:
        sentence = _about(parse_certificate(data), verdict, host, trust_with)
    return LinkRefusedError(
        FaultKind.CERTIFICATE,
        verdict.value,
        f"not connected: {sentence} ({verdict.value})",
    )


def _about(
    certificate: x509.Certificate,
    verdict: CertificateVerdict,
    host: str,
    trust_with: str,
) -> str:
    if verdict is CertificateVerdict.HOST:
        names = _listed(host_names(certificate)) or "no host"
        return (
            f"its certificate names {names}, not {_quoted(host)}: if it is the right one, put a"
            " name of the certificate into endpoint or peer_host"
        )
    if verdict is CertificateVerdict.TIME:
        begin = certificate.not_valid_before_utc
        end = certificate.not_valid_after_utc
        return (
            f"its certificate is valid from {begin:%Y-%m-%d %H:%M} to {end:%Y-%m-%d %H:%M} UTC,"
            " not now: renew it, or set the clocks"
        )
    mark = thumbprint(certificate)
    return f"its certificate {mark} is not trusted: {trust_with.replace('THUMBPRINT', mark[:16])}"


def policy_missing(
    wanted: str,
    endpoints: Sequence[ua.EndpointDescription],
    policy_names: dict[str, str],
) -> LinkRefusedError:
    """Return that no endpoint has the configured policy and mode, and those there are."""
    offered = dict.fromkeys(
        f"{policy_names.get(e.SecurityPolicyUri or '', _quoted(e.SecurityPolicyUri))}"
        f" ({e.SecurityMode.name})"
        for e in endpoints
    )
    offered_names = ", ".join(list(offered)[:10]) or "nothing"
    return LinkRefusedError(
        FaultKind.SECURITY_POLICY,
        "endpoint",
        f"not connected: there is no endpoint with {wanted}; the server offers:"
        f" {offered_names}; set security of the peer, or add the"
        " policy there",
    )


def token_missing(
    user: str | None, offered: Iterable[ua.UserTokenPolicy]
) -> LinkRefusedError:
    """Return that the endpoint does not accept our kind of log-in."""
    kinds = _listed([policy.TokenType.name for policy in offered]) or "nothing"
    if user is None:
        remedy = "set user and password_file"
    else:
        remedy = "remove user and password_file"
    what = "anonymous clients" if user is None else "user names"
    return LinkRefusedError(
        FaultKind.LOG_IN,
        "token",
        f"not connected: it accepts no {what} at this endpoint, only {kinds}: {remedy}",
    )


def password_exposed(policy: str) -> LinkRefusedError:
    """Return that the password would be sent without sufficient encryption."""
    return LinkRefusedError(
        FaultKind.LOG_IN,
        "exposed",
        f"not connected: it asks for the password with {_quoted(policy) or 'no'} encryption: set"
        f" mode:"
        " sign_and_encrypt",
    )


def refused_by_peer(
    error: ua.UaStatusCodeError, user: str | None, ours: str
) -> LinkRefusedError | None:
    """Return why the peer refuses us, None if the reason is not one of security."""
    code = ua.StatusCode(ua.UInt32(error.code)).name
    if code in _LOG_IN_CODES:
        who = "anonymous clients" if user is None else f"user '{user}'"
        if user is None:
            remedy = "set user and password_file"
        else:
            remedy = "check user and password_file"
        kind = FaultKind.LOG_IN
        sentence = f"it refuses {who}: {remedy}"
    elif code in _POLICY_CODES:
        kind = FaultKind.SECURITY_POLICY
        sentence = "it refuses this policy and mode: set security"
    elif code.startswith("BadCertificate") or code == "BadSecurityChecksFailed":
        which = f"our certificate {ours}" if ours else "an unprotected connection"
        remedy = "trust it there, and check both clocks" if ours else "set security"
        kind = FaultKind.CERTIFICATE
        sentence = f"it refuses {which}: {remedy}"
    else:
        return None
    return LinkRefusedError(kind, code, f"not connected: {sentence} ({code})")


def hung_up(ours: str) -> LinkRefusedError:
    """Return that the peer closed the connection instead of answering our certificate `ours`."""
    return LinkRefusedError(
        FaultKind.CERTIFICATE,
        "closed",
        f"not connected: it closes the connection after receiving our certificate {ours}: trust it"
        f" there, and check both clocks",
    )


def _quoted(text: str | None) -> str:
    """Return a text of the peer, shortened and without control characters."""
    return "".join(c if c.isprintable() else "?" for c in (text or "")[:_LONGEST])


def _listed(names: Sequence[str]) -> str:
    more = f" and {len(names) - _SHOWN} more" if len(names) > _SHOWN else ""
    return ", ".join(map(_quoted, names[:_SHOWN])) + more
