"""Who may do what: the one place where users and roles are decided.

`Access` is asked at log-in, before every write and before every method call. On loopback, as long
as no users are named, everybody is an anonymous engineer.
"""

import asyncio
import time
from collections.abc import Mapping
from dataclasses import dataclass
from fnmatch import fnmatchcase

from asyncua.crypto.permission_rules import User, UserRole

from hilserver.config.server import OpcUaConfig, Role
from hilserver.io.opcua_security.attempts import WINDOW_S, FailedAttempts, keys_of
from hilserver.io.opcua_security.passwords import MAX_PASSWORD_BYTES, hash_password, is_password
from hilserver.io.opcua_server.logs import log

_MAX_WAITING = 10


@dataclass
class RobotUser(User):  # type: ignore[misc]
    """The user of a session; asyncua's administrator is only the server's own session."""

    rights: Role = Role.OBSERVER


class Access:
    """Users, their roles, and what a role may do.

    Passwords are checked one after the other in a thread: each check costs memory and time by
    design, and a flood of log-ins must not cost more than one.
    """

    def __init__(self, config: OpcUaConfig) -> None:
        self._anonymous = config.anonymous_role
        self._users = {user.name: user for user in config.users}
        self._write, self._call = config.permissions.write, config.permissions.call
        self._attempts = FailedAttempts(config.max_failed_logins, WINDOW_S)
        self._turn = asyncio.Lock()
        self._waiting = 0
        self._nobodys_hash = hash_password("") if self._users else ""

    @property
    def has_users(self) -> bool:
        """Whether anybody can log in with a password."""
        return bool(self._users)

    @property
    def admits_anonymous(self) -> bool:
        """Whether a client may do without a name."""
        return self._anonymous is not None

    def anonymous(self) -> RobotUser | None:
        """Return the user without a name, None to refuse."""
        if self._anonymous is None:
            return None
        return RobotUser(UserRole.User, None, self._anonymous)

    async def log_in(self, name: str, password: bytes, address: str) -> RobotUser | None:
        """Return the user, None if name or password is wrong or too many attempts failed.

        The answer tells nobody which of them it was, nor does the time it takes.
        """
        keys = keys_of(name, address)
        now_s = time.monotonic()
        if any(self._attempts.is_blocked(key, now_s) for key in keys) or (
            self._waiting >= _MAX_WAITING
        ):
            log.warning("opcua log-in refused: too many failed", user=name[:64], address=address)
            return None
        user = self._users.get(name)
        is_right = await self._is_right(password, user.password if user else self._nobodys_hash)
        if user is None or not is_right:
            for key in keys:
                self._attempts.failed(key, now_s)
            log.warning("opcua log-in failed", user=name[:64], address=address)
            return None
        for key in keys:
            self._attempts.succeeded(key)
        return RobotUser(UserRole.User, user.name, Role[user.role.upper()])

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
    if not isinstance(user, RobotUser):
        return False
    needed: str | None = None
    for pattern, role in table.items():
        if fnmatchcase(name, pattern):
            needed = role
    return needed is not None and user.rights >= Role[needed.upper()]
