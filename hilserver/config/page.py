"""The sections ``page:`` and ``folders:``: the operator page and the folders of its files."""

from pathlib import Path
from typing import Self

from pydantic import Field, model_validator

from hilserver.config.section import Section
from hilserver.opcua.loopback import is_loopback


class PageTlsConfig(Section):
    """Certificate and key of the page, PEM; relative to the configuration file."""

    certificate: Path = Field(description="Certificate, with its chain")
    key: Path = Field(description="Private key, without a passphrase")


class PageConfig(Section):
    """The operator page, a process of its own beside the daemon."""

    enabled: bool = Field(True, description="hilserver run starts the page")
    host: str = Field(
        "127.0.0.1", min_length=1, max_length=253, description="Address to listen on"
    )
    port: int = Field(
        8080, ge=0, le=65535, description="If in use, the next free one is taken"
    )
    rate_hz: float = Field(30.0, ge=1, le=60, description="Frames a second")
    deadman_ms: float = Field(
        300.0,
        ge=50,
        le=5000,
        description="Set-points become zero if a held command is not renewed for this long",
    )
    tls: PageTlsConfig | None = Field(None, description="Needed beyond loopback")
    allow_insecure_network: bool = Field(
        False, description="Listen beyond loopback without tls"
    )
    max_clients: int = Field(
        20, ge=1, le=100, description="Browsers served at the same time"
    )

    @property
    def is_open_to_network(self) -> bool:
        """Whether other computers reach the page."""
        return not is_loopback(self.host)

    @model_validator(mode="after")
    def _closed_to_network(self) -> Self:
        is_safe = not self.is_open_to_network or self.tls or self.allow_insecure_network
        if self.enabled and not is_safe:
            raise ValueError(
                f"host '{self.host}' is reachable from the network, and passwords would be sent in"
                " the clear: set tls, listen on 127.0.0.1, or set allow_insecure_network: true"
            )
        return self


class FoldersConfig(Section):
    """Folders that commands over OPC UA and the page may name files in; relative to this file."""

    recordings: Path = Field(
        Path("recordings"), description="Recordings, and logs to diagnose"
    )
    scenarios: Path = Field(Path("scenarios"), description="Scenarios to start")
    patches: Path = Field(Path("patches"), description="Model patches to load")
    reports: Path = Field(
        Path("reports"), description="Reports of diagnoses started on the page"
    )
    sweeps: Path = Field(
        Path("sweeps"), description="Sweeps, a folder each, whose reports are listed"
    )
