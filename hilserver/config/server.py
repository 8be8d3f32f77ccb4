"""The `opcua:` section: our OPC UA server."""

import ipaddress
from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator


def _check_endpoint(text: str) -> str:
    url = urlsplit(text)
    try:
        port = url.port
    except ValueError:
        port = None
    if url.scheme != "opc.tcp" or not url.hostname or port is None:
        raise ValueError(f"'{text}' is no endpoint; write opc.tcp://<address>:<port>/<path>")
    return text


def is_loopback(host: str) -> bool:
    """Whether only programs on this computer reach `host`; a name other than localhost is not."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


class OpcUaConfig(BaseModel):
    """Endpoint and limits of the OPC UA server."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    enabled: bool = Field(default=True, description="Start the OPC UA server")
    endpoint: Annotated[str, AfterValidator(_check_endpoint)] = Field(
        default="opc.tcp://127.0.0.1:4840/hilserver",
        description="Address, port and path to listen on; port 0 takes any free port",
    )
    application_uri: str | None = Field(
        default=None,
        min_length=1,
        max_length=256,
        description="Application URI; urn:<host name>:hilserver when left out",
    )
    allow_insecure_network: bool = Field(
        default=False,
        description="Listen on other addresses than loopback although everyone there may then"
        " read, write and command without a password",
    )
    min_publishing_ms: float = Field(
        default=5.0,
        ge=1.0,
        le=1000.0,
        description="Shortest publishing interval that a subscription gets",
    )
    max_connections: int = Field(default=200, ge=1, le=10_000, description="Open TCP connections")
    max_sessions: int = Field(default=100, ge=1, le=10_000, description="Open sessions")
    max_subscriptions: int = Field(
        default=200, ge=1, le=10_000, description="Subscriptions of all sessions together"
    )
    max_queue_size: int = Field(
        default=1000, ge=1, le=10_000, description="Longest queue of a monitored item"
    )
    max_events_per_s: int = Field(
        default=10, ge=1, le=1000, description="Events sent per kind; the rest is counted"
    )

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

    @model_validator(mode="after")
    def _closed_to_network(self) -> "OpcUaConfig":
        if self.enabled and self.is_open_to_network and not self.allow_insecure_network:
            raise ValueError(
                f"endpoint '{self.endpoint}' is reachable from the network, and the server has no"
                " passwords yet: listen on 127.0.0.1, or set allow_insecure_network: true"
            )
        return self
