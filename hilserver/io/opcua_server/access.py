"""Who may do what: the one place where users and roles are decided.

On loopback everybody is the anonymous operator. Certificates, users and roles come in here and
nowhere else: `Access` is asked at log-in, before every write and before every method call.
"""

from typing import Any

from asyncua.crypto.permission_rules import User, UserRole


class Access:
    """Open access: every client is the same user, who may write inputs and call methods.

    asyncua asks `get_user` at ActivateSession; its own default makes an administrator of anyone who
    calls himself "admin", this one does not. Administrator is only the server's own session.
    """

    def get_user(
        self,
        iserver: Any,  # noqa: ARG002 - asyncua's signature
        username: str | None = None,
        password: str | None = None,  # noqa: ARG002
        certificate: Any = None,  # noqa: ARG002
    ) -> User | None:
        """Return the user of a session, None to refuse the log-in."""
        return User(role=UserRole.User, name=username)

    def may_write(self, user: User, path: str) -> bool:  # noqa: ARG002
        """Whether `user` may write the variable `path`."""
        return True

    def may_call(self, user: User, method: str) -> bool:  # noqa: ARG002
        """Whether `user` may call the method of that name."""
        return True
