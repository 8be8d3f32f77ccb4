"""Who stands behind a session: the user token of ActivateSession."""

import struct
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto

from hilserver.io.opcua_security.passwords import MAX_PASSWORD_BYTES
from hilserver.io.opcua_server.access import Access, RobotUser

_DECRYPT = {
    "http://www.w3.org/2001/04/xmlenc#rsa-oaep": uacrypto.decrypt_rsa_oaep,
    "http://opcfoundation.org/UA/security/rsa-oaep-sha2-256": uacrypto.decrypt_rsa_oaep_sha256,
}
_Codes = ua.StatusCodes


async def identify(
    access: Access, token: Any, *, is_encrypted: bool, key: Any, nonce: bytes, address: str
) -> RobotUser:
    """Return the user that a token names.

    Parameters
    ----------
    is_encrypted : bool
        Whether the channel is; a password in the clear is accepted on no other.
    key : RSA private key or None
        Decrypts a password that is encrypted itself.
    nonce : bytes
        What we gave the client last; an encrypted password must contain it.

    Raises
    ------
    ServiceError
        BadIdentityTokenRejected, BadIdentityTokenInvalid or BadUserAccessDenied.
    """
    is_empty = token is None or (
        isinstance(token, ua.ExtensionObject) and token.TypeId == ua.NodeId(ua.ObjectIds.Null)
    )
    if is_empty or isinstance(token, ua.AnonymousIdentityToken):
        user = access.anonymous()
        if user is None:
            raise ServiceError(_Codes.BadIdentityTokenRejected)
        return user
    if not isinstance(token, ua.UserNameIdentityToken) or not access.has_users:
        raise ServiceError(_Codes.BadIdentityTokenRejected)
    if not token.EncryptionAlgorithm and not is_encrypted:
        raise ServiceError(_Codes.BadIdentityTokenRejected)
    password = _password(token, key, nonce)
    user = await access.log_in(token.UserName or "", password, address)
    if user is None:
        raise ServiceError(_Codes.BadUserAccessDenied)
    return user


def _password(token: ua.UserNameIdentityToken, key: Any, nonce: bytes) -> bytes:
    data = token.Password or b""
    data = data.encode() if isinstance(data, str) else bytes(data)
    if token.EncryptionAlgorithm:
        decrypt = _DECRYPT.get(token.EncryptionAlgorithm)
        if decrypt is None or key is None:
            raise ServiceError(_Codes.BadIdentityTokenInvalid)
        try:
            plain = decrypt(key, data)
            (length,) = struct.unpack_from("<I", plain)
        except (ValueError, struct.error):
            raise ServiceError(_Codes.BadIdentityTokenInvalid) from None
        secret = plain[4 : 4 + length]
        if not nonce or not secret.endswith(nonce):
            raise ServiceError(_Codes.BadIdentityTokenInvalid)
        data = secret[: -len(nonce)]
    if len(data) > MAX_PASSWORD_BYTES:
        raise ServiceError(_Codes.BadIdentityTokenInvalid)
    return data
