"""How the link to a peer is protected: ``peers[].security``."""

from pathlib import Path
from typing import Annotated, Literal

from pydantic import BeforeValidator, Field, model_validator

from hilserver.config.section import Section
from hilserver.opcua.settings import Policy

Mode = Literal["sign", "sign_and_encrypt"]


def _none_is_a_policy(value: object) -> object:
    return "None" if value is None else value


class PeerSecurity(Section):
    """Policy, certificates and user of the link to one peer.

    With a policy other than ``None`` the peer's certificate is judged before anything else is sent;
    see docs/how-to/secure-peers.md. Relative paths start from the folder of the configuration.
    """

    policy: Annotated[Policy, BeforeValidator(_none_is_a_policy)] = Field(
        "None", description="security policy; the peer must offer exactly this one"
    )
    mode: Mode | None = Field(
        None, description="sign or sign_and_encrypt; default: sign_and_encrypt"
    )
    certificate: Path | None = Field(
        None,
        description="our certificate; default: own/certificate.der in opcua.certificates",
    )
    private_key: Path | None = Field(
        None, description="its key; default: that of the server (opcua.private_key)"
    )
    trust: Path | None = Field(
        None,
        description="folder with trusted, rejected and revoked for this peer's certificate; when"
        " left out opcua.certificates",
    )
    peer_certificate: Path | None = Field(
        None,
        description="the certificate that the peer must present, or that of its authority; replaces"
        " the folder trusted",
    )
    peer_host: Annotated[str, Field(min_length=1, max_length=253)] | None = Field(
        None,
        description="name or address that the peer's certificate must name; default: the host of"
        " endpoint",
    )
    user: Annotated[str, Field(min_length=1, max_length=64)] | None = Field(
        None, description="name to log in with; default: anonymous"
    )
    password_file: Path | None = Field(
        None, description="file with the password, readable by its owner only"
    )
    allow_clear_password: bool = Field(
        default=False,
        description="Log in over policy None even though others on the network can read the"
        " password",
    )

    @property
    def is_secure(self) -> bool:
        """Whether the link is at least signed."""
        return self.policy != "None"

    @property
    def effective_mode(self) -> Mode:
        """Mode of a secure link."""
        return self.mode or "sign_and_encrypt"

    @property
    def about(self) -> str:
        """How the link is protected, and the user name we log in with."""
        if self.is_secure:
            how = f"{self.policy} {self.effective_mode}"
        else:
            how = "policy None"
        if self.user is None:
            return how
        return f"{how}, as user '{self.user}'"

    @model_validator(mode="after")
    def _only_what_acts(self) -> "PeerSecurity":
        if not self.is_secure:
            names = (
                "mode",
                "certificate",
                "private_key",
                "trust",
                "peer_certificate",
                "peer_host",
            )
            idle = [name for name in names if getattr(self, name) is not None]
            if idle:
                raise ValueError(
                    f"{idle[0]} has no effect while policy is None: remove it, or set policy,"
                    " for example to Basic256Sha256"
                )
        for pair in (("certificate", "private_key"), ("user", "password_file")):
            given, missing = sorted(pair, key=lambda name: getattr(self, name) is None)
            if getattr(self, given) is not None and getattr(self, missing) is None:
                raise ValueError(
                    f"{given} needs {missing} as well: give both, or neither"
                )
        if self.allow_clear_password and (self.is_secure or self.user is None):
            raise ValueError(
                "allow_clear_password has no effect unless a user logs in over policy None:"
                " remove it"
            )
        return self
