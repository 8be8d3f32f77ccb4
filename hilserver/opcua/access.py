"""Who may do what: the one place where users and roles are decided.

`Access` is consulted at log-in, before every write and before every method call. On loopback, as
long as no users are configured, every client is an anonymous engineer. `identify` finds the user of
a session from the user token of ActivateSession.
"""

import asyncio
import struct
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from asyncua import ua
from asyncua.common.utils import ServiceError
from asyncua.crypto import uacrypto
from asyncua.crypto.permission_rules import User, UserRole

from hilserver.opcua.logs import log
from hilserver.opcua.passwords import (
    MAX_PASSWORD_BYTES,
    WINDOW_S,
    FailedAttempts,
    hash_password,
    is_password,
    keys_of,
)
from hilserver.opcua.settings import OpcUaSettings, Role, needed_role

_MAX_WAITING = 10
_DECRYPT = {
    "http://www.w3.org/2001/04/xmlenc#rsa-oaep": uacrypto.decrypt_rsa_oaep,
    "http://opcfoundation.org/UA/security/rsa-oaep-sha2-256": uacrypto.decrypt_rsa_oaep_sha256,
}
_Codes = ua.StatusCodes


@dataclass
class RoleUser(User):  # type: ignore[misc]
    """The user of a session; asyncua's administrator is only the server's own session."""

    rights: Role = Role.OBSERVER


class Access:
    """Users, their roles, and what a role may do.

    Passwords are checked one after the other in a thread: each check costs memory and time by
    design, and a flood of log-ins must not cost more than one.
    """

    def __init__(self, settings: OpcUaSettings) -> None:
        self._anonymous = settings.anonymous_role
        self._users = {user.name: user for user in settings.users}
        self._write = settings.permissions.write
        self._call = settings.permissions.call
        self._attempts = FailedAttempts(settings.max_failed_logins, WINDOW_S)
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._nobodys_hash = hash_password("") if self._users else ""

    @property
    def has_users(self) -> bool:
        """Whether there are users who log in with a password."""
        return bool(self._users)

    @property
    def admits_anonymous(self) -> bool:
        """Whether a client may connect without a user name."""
        return self._anonymous is not None

    def anonymous(self) -> RoleUser | None:
        """Return the anonymous user, None to refuse."""
        if self._anonymous is None:
            return None
        return RoleUser(UserRole.User, None, self._anonymous)

    async def log_in(self, name: str, password: bytes, address: str) -> RoleUser | None:
        """Return the user, None if name or password is wrong or too many attempts failed.

        Neither the answer nor the time it takes reveals which of them it was.
        """
        keys = keys_of(name, address)
        now_s = time.monotonic()
        is_blocked = any(self._attempts.is_blocked(key, now_s) for key in keys)
        if is_blocked or (self._waiting >= _MAX_WAITING):
            log.warning(
                "opcua log-in refused: too many failures",
                user=name[:64],
                address=address,
            )
            return None
        user = self._users.get(name)
        is_right = await self._is_right(
            password, user.password if user else self._nobodys_hash
        )
        if user is None or not is_right:
            for key in keys:
                self._attempts.failed(key, now_s)
            log.warning("opcua log-in failed", user=name[:64], address=address)
            return None
        for key in keys:
            self._attempts.succeeded(key)
        return RoleUser(UserRole.User, user.name, Role[user.role.upper()])

    async def _is_right(self, password: bytes, password_hash: str) -> bool:
        if not password_hash or len(password) > MAX_PASSWORD_BYTES:
            return False
        self._waiting += 1
        try:
            async with self._turn:
                return await asyncio.to_thread(is_password, password, password_hash)
        finally:
            self._waiting -= 1

    def may_write(self, user: User, path: str) -> bool:
        """Whether `user` may write the variable `path`."""
        return _is_enough(user, self._write, path)

    def may_call(self, user: User, method: str) -> bool:
        """Whether `user` may call the method of that name."""
        return _is_enough(user, self._call, method)


def _is_enough(user: User, table: Mapping[str, str], name: str) -> bool:
    if not isinstance(user, RoleUser):
        return False
    needed = needed_role(table, name)
    return needed is not None and user.rights >= needed


async def identify(
    access: Access,
    token: Any,
    *,
    is_encrypted: bool,
    key: Any,
    nonce: bytes,
    address: str,
) -> RoleUser:
    """Return the user that a token names.

    ServiceError: BadIdentityTokenRejected, BadIdentityTokenInvalid or BadUserAccessDenied.

    Parameters
    ----------
    is_encrypted : bool
        Whether the channel is; only then a password in clear text is accepted.
    key : RSA private key or None
        Decrypts a password that is itself encrypted.
    nonce : bytes
        The last one that we sent to the client; an encrypted password must contain it.
    """
    is_empty = token is None or (
        isinstance(token, ua.ExtensionObject)
        and token.TypeId == ua.NodeId(ua.ObjectIds.Null)
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
