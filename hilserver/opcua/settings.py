"""Endpoint, security and limits of a server, checked when they are made."""

import re
import socket
from collections.abc import Mapping
from enum import IntEnum
from fnmatch import fnmatchcase
from pathlib import Path
from typing import Annotated, Literal, Self
from urllib.parse import urlsplit

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    model_validator,
)

from hilserver.opcua.loopback import is_loopback

Policy = Literal["None", "Basic256Sha256", "Aes128Sha256RsaOaep", "Aes256Sha256RsaPss"]
RoleName = Literal["observer", "operator", "engineer"]
SECURE_POLICIES: tuple[Policy, ...] = (
    "Basic256Sha256",
    "Aes128Sha256RsaOaep",
    "Aes256Sha256RsaPss",
)
_PASSWORD_HASH = re.compile(r"\$scrypt\$[A-Za-z0-9+/=,$]+")


class Role(IntEnum):
    """What a user may do; each role includes the ones before. Everyone may read."""

    OBSERVER = 0
    OPERATOR = 1
    ENGINEER = 2


def _none_is_a_policy(value: object) -> object:
    if isinstance(value, list):
        return ["None" if item is None else item for item in value]
    return value


def _check_hash(text: str) -> str:
    if _PASSWORD_HASH.fullmatch(text) is None:
        raise ValueError(
            "is not a scrypt hash; make one with 'hilserver certs password'"
        )
    return text


def default_application_uri() -> str:
    """Return the application URI if none is configured."""
    return f"urn:{socket.gethostname()}:hilserver"


def needed_role(table: Mapping[str, str], name: str) -> Role | None:
    """Return the lowest role that a table of permissions demands for a name; None: nobody may."""
    needed = None
    for pattern, role in table.items():
        if fnmatchcase(name, pattern):
            needed = Role[role.upper()]
    return needed


def check_endpoint(text: str) -> str:
    """Return an OPC UA endpoint as it was given.

    ValueError if it is not one, or contains a password, which everyone could read.
    """
    try:
        parts = urlsplit(text)
        complete = (
            parts.scheme == "opc.tcp" and parts.hostname and parts.port is not None
        )
    except ValueError:
        complete = False
    if not complete:
        raise ValueError(
            f"'{text}' is not an endpoint: write opc.tcp://<host>:<port>/<path>"
        )
    if "@" in parts.netloc:
        raise ValueError("an endpoint must not contain a user name or password")
    return text


class _Checked(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class OpcUaUser(_Checked):
    """Somebody who logs in with name and password."""

    name: str = Field(min_length=1, max_length=64, description="User name")
    password: Annotated[str, AfterValidator(_check_hash)] = Field(
        description="scrypt hash, made with hilserver certs password", repr=False
    )
    role: RoleName = Field(default="observer", description="What the user may do")


class OpcUaPermissions(_Checked):
    """The lowest role that may write a variable or call a method; of several rows the last wins.

    Patterns are those of file names: ``*`` stands for any text.
    """

    write: dict[str, RoleName] = Field(
        default={"*": "operator"},
        description="Pattern of signal names: lowest role that may write",
    )
    call: dict[str, RoleName] = Field(
        default={"*": "engineer"},
        description="Pattern of method names: lowest role that may call",
    )


class OpcUaShare(_Checked):
    """What one session may hold."""

    subscriptions: int = Field(
        ge=1, le=10_000, description="Subscriptions of one session"
    )
    monitored_items: int = Field(
        ge=1, le=100_000, description="Monitored items of one session"
    )
    queued_values: int = Field(
        ge=0,
        le=1_000_000,
        description="Queued values of one session, beyond one per monitored item",
    )


class OpcUaLimits(_Checked):
    """What one session may hold, by the role of its user."""

    observer: OpcUaShare = OpcUaShare(
        subscriptions=10, monitored_items=1000, queued_values=5000
    )
    operator: OpcUaShare = OpcUaShare(
        subscriptions=20, monitored_items=2000, queued_values=10_000
    )
    engineer: OpcUaShare = OpcUaShare(
        subscriptions=50, monitored_items=5000, queued_values=20_000
    )

    def of(self, role: Role) -> OpcUaShare:
        """Return the share of a role."""
        return getattr(self, role.name.lower())  # type: ignore[no-any-return]


class OpcUaSettings(_Checked):
    """Endpoint, security and limits of a server."""

    endpoint: Annotated[str, AfterValidator(check_endpoint)] = Field(
        default="opc.tcp://127.0.0.1:4840/hilserver",
        description="Address, port and path to listen on; port 0 takes any free port",
    )
    application_uri: str | None = Field(
        default=None,
        min_length=1,
        max_length=256,
        description="Application URI; default: urn:<host name>:hilserver",
    )
    policies: (
        Annotated[tuple[Policy, ...], BeforeValidator(_none_is_a_policy)] | None
    ) = Field(
        default=None,
        min_length=1,
        description="Security policies that clients may choose, all but None with SignAndEncrypt;"
        " default: None on loopback, elsewhere the three secure ones",
    )
    certificates: Path = Field(
        default=Path("certificates"),
        description="Folder with own, trusted, rejected and revoked, created by hilserver certs;"
        " relative to this file",
    )
    private_key: Path | None = Field(
        default=None, description="Key file, if it is not own/key.pem in that folder"
    )
    users: tuple[OpcUaUser, ...] = Field(default=(), description="Who may log in")
    anonymous: Literal[RoleName, "nobody"] | None = Field(
        default=None,
        description="Role of an anonymous client; default: engineer on loopback without users,"
        " otherwise nobody",
    )
    permissions: OpcUaPermissions = Field(
        default_factory=OpcUaPermissions, description="Who may write and call what"
    )
    allow_insecure_network: bool = Field(
        default=False,
        description="Listen on addresses other than loopback, although everyone there may then"
        " read, write and command without a password",
    )
    max_failed_logins: int = Field(
        default=5,
        ge=1,
        le=1000,
        description="Failed log-ins per minute and user name, and per address other than loopback",
    )
    max_message_bytes: int = Field(
        default=262_144,
        ge=65_536,
        le=16_777_216,
        description="Longest request, all chunks together [bytes]; 65536 before the log-in",
    )
    max_operations: int = Field(
        default=1000,
        ge=10,
        le=10_000,
        description="Nodes in one request of any service",
    )
    max_monitored_items: int = Field(
        default=10_000,
        ge=1,
        le=100_000,
        description="Monitored items of all sessions together",
    )
    min_publishing_ms: float = Field(
        default=5.0,
        ge=1.0,
        le=1000.0,
        description="Shortest publishing interval granted to a subscription",
    )
    max_connections: int = Field(
        default=200, ge=1, le=10_000, description="Open TCP connections"
    )
    max_sessions: int = Field(default=100, ge=1, le=10_000, description="Open sessions")
    max_subscriptions: int = Field(
        default=200,
        ge=1,
        le=10_000,
        description="Subscriptions of all sessions together",
    )
    max_queue_size: int = Field(
        default=1000, ge=1, le=10_000, description="Longest queue of a monitored item"
    )
    max_queued_values: int = Field(
        default=50_000,
        ge=0,
        le=1_000_000,
        description="Queued values of all sessions together, beyond one per monitored item",
    )
    limits: OpcUaLimits = Field(
        default_factory=OpcUaLimits, description="Limits for one session, by role"
    )

    @property
    def is_used(self) -> bool:
        """Whether a server will listen with these settings."""
        return True

    @property
    def host(self) -> str:
        """Address to listen on."""
        return urlsplit(self.endpoint).hostname or ""

    @property
    def port(self) -> int:
        """TCP port to listen on, 0 for any free one."""
        return urlsplit(self.endpoint).port or 0

    @property
    def is_open_to_network(self) -> bool:
        """Whether other computers reach the server."""
        return not is_loopback(self.host)

    @property
    def offered_policies(self) -> tuple[Policy, ...]:
        """Security policies that clients may choose."""
        if self.policies is not None:
            return self.policies
        insecure = not self.is_open_to_network or self.allow_insecure_network
        return ("None",) if insecure else SECURE_POLICIES

    @property
    def needs_certificate(self) -> bool:
        """Whether a client may choose a policy that needs one."""
        return any(policy != "None" for policy in self.offered_policies)

    @property
    def is_secure(self) -> bool:
        """Whether every session is encrypted and every client known by its certificate."""
        return "None" not in self.offered_policies

    @property
    def anonymous_role(self) -> Role | None:
        """Role of a client that gives no name; None: it is refused."""
        if self.anonymous is not None:
            if self.anonymous == "nobody":
                return None
            return Role[self.anonymous.upper()]
        if self.users or (self.is_open_to_network and not self.allow_insecure_network):
            return None
        return Role.ENGINEER

    @model_validator(mode="after")
    def _closed_to_network(self) -> Self:
        if (
            not self.is_used
            or not self.is_open_to_network
            or self.allow_insecure_network
        ):
            return self
        place = f"endpoint '{self.endpoint}' is reachable from the network"
        if not self.is_secure:
            raise ValueError(
                f"{place}, and policy None does not encrypt: remove it from policies, listen on"
                " 127.0.0.1, or set allow_insecure_network: true"
            )
        if self.anonymous_role not in (None, Role.OBSERVER):
            raise ValueError(
                f"{place}: anonymous may only be nobody or observer there; name users instead, or"
                f" set allow_insecure_network: true"
            )
        if not self.users and self.anonymous_role is None:
            raise ValueError(
                f"{place}, and nobody may log in: name users (docs/how-to/secure-the-server.md),"
                " listen on 127.0.0.1, or set allow_insecure_network: true"
            )
        return self

    @model_validator(mode="after")
    def _distinct_users(self) -> Self:
        names = [user.name for user in self.users]
        twice = sorted({name for name in names if names.count(name) > 1})
        if twice:
            raise ValueError(f"user '{twice[0]}' is named twice")
        if self.users and self.offered_policies == ("None",):
            raise ValueError(
                "users need an encrypted connection for their passwords: add a secure policy to"
                " policies, for example [Basic256Sha256]"
            )
        return self
