"""How a connection gets a session and loses it: CreateSession, ActivateSession, lost connections.

A session belongs to the client that opened its channel; with the same certificate and user it may
move to another connection of that client (OPC 10000-4, 5.7.3).
"""

from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto.uacrypto import InvalidSignature

from hilserver.opcua.access import identify
from hilserver.opcua.certificate import application_uris, parse_certificate
from hilserver.opcua.logs import log

_MAX_CLIENT_TEXT = 4096
_NONCE_BYTES = 32
_Codes = ua.StatusCodes
_Modes = ua.MessageSecurityMode


async def create_session(processor: Any, params: Any) -> ua.CreateSessionResponse:
    """Answer CreateSession: one session per connection."""
    iserver = processor.iserver
    policy = processor.policy
    if processor.session is not None:
        if processor.session.is_activated:
            raise ServiceError(_Codes.BadTooManySessions)
        processor.session.close()
    _check_client(processor, params)
    asked = ua.GetEndpointsParameters(EndpointUrl=params.EndpointUrl)
    endpoints = await iserver.get_endpoints(asked, processor.sockname)
    processor.session = session = iserver.new_session(
        processor, policy, params.SessionName
    )
    response = ua.CreateSessionResponse()
    result = response.Parameters = session.create(params)
    result.ServerEndpoints = endpoints
    result.MaxRequestMessageSize = iserver.settings.max_message_bytes
    result.ServerCertificate = policy.host_certificate
    signed = (policy.peer_certificate or b"") + (params.ClientNonce or b"")
    result.ServerSignature.Signature = policy.asymmetric_cryptography.signature(signed)
    result.ServerSignature.Algorithm = policy.AsymmetricSignatureURI
    return response


def _check_client(processor: Any, params: ua.CreateSessionParameters) -> None:
    """Check that the session is requested by the application that opened the channel."""
    policy = processor.policy
    texts = (params.EndpointUrl, params.SessionName, params.ServerUri)
    if any(len(text or "") > _MAX_CLIENT_TEXT for text in texts):
        raise ServiceError(_Codes.BadInvalidArgument)
    if policy.Mode == _Modes.None_:
        return
    certificate = policy.peer_certificate
    if not (params.ClientCertificate or b"").startswith(certificate):
        raise ServiceError(_Codes.BadSecurityChecksFailed)
    if len(params.ClientNonce or b"") < _NONCE_BYTES:
        raise ServiceError(_Codes.BadNonceInvalid)
    uri = params.ClientDescription.ApplicationUri
    if uri not in application_uris(parse_certificate(certificate)):
        log.warning("opcua certificate names another URI", announced=str(uri)[:200])
        processor.iserver.trust.keep_rejected(certificate, processor.address)
        raise ServiceError(_Codes.BadCertificateUriInvalid)


async def activate_session(
    processor: Any, token: Any, params: Any
) -> ua.ActivateSessionResponse:
    """Answer ActivateSession: admit a proven client of the session with a known user."""
    iserver = processor.iserver
    policy = processor.policy
    session = iserver.sessions.get(token)
    if session is None or (
        processor.session is not None and session is not processor.session
    ):
        raise ServiceError(_Codes.BadSessionIdInvalid)
    session.touch()
    is_moved = session.processor is not processor
    if is_moved and not session.is_activated:
        raise ServiceError(_Codes.BadSessionIdInvalid)
    if not session.is_of(policy):
        raise ServiceError(_Codes.BadSecurityChecksFailed)
    try:
        signed = (policy.host_certificate or b"") + session.nonce
        policy.asymmetric_cryptography.verify(signed, params.ClientSignature.Signature)
    except (InvalidSignature, TypeError):
        raise ServiceError(_Codes.BadApplicationSignatureInvalid) from None
    user = await identify(
        iserver.access,
        params.UserIdentityToken,
        is_encrypted=policy.Mode == _Modes.SignAndEncrypt,
        key=iserver.private_key,
        nonce=session.nonce,
        address=session.visitor.address,
    )
    if not session.is_open:  # it has ended meanwhile
        raise ServiceError(_Codes.BadSessionIdInvalid)
    if is_moved:
        if user != session.user:
            raise ServiceError(_Codes.BadUserAccessDenied)
        # From another connection of the same, proven client.
        if session.processor is not None and session.processor.session is session:
            session.processor.session = None
        session.bind(processor, processor.policy)
        processor.session = session
    if not session.is_activated:
        iserver.admit(session, user)
    response = ua.ActivateSessionResponse()
    response.Parameters = session.activate(user)
    return response


def release_session(processor: Any) -> None:
    """Release the session of a lost connection; its subscriptions may outlive it."""
    session = processor.session
    processor.session = None
    if session is None or session.processor is not processor:
        return
    session.lose_connection()
