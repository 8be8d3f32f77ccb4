"""The section ``foxglove:``: an endpoint for Foxglove, Lichtblick and PlotJuggler."""

from typing import Self

from pydantic import Field, model_validator

from hilserver.config.doors import GRANTS, WRITING, DoorRule, Grant
from hilserver.config.section import Section, need
from hilserver.opcua.loopback import is_loopback


class FoxgloveConfig(Section):
    """Live signals, transforms and the hall for viewers (extra foxglove)."""

    enabled: bool = Field(False, description="Serve viewers")
    host: str = Field(
        "127.0.0.1", min_length=1, max_length=253, description="Address to listen on"
    )
    port: int = Field(8765, ge=0, le=65535, description="0 takes any free port")
    rate_hz: float = Field(30.0, ge=1, le=100, description="Frames a second")
    origins: tuple[str, ...] = Field(
        ("https://app.foxglove.dev", "file://"),
        max_length=100,
        description="Web pages that may connect (file:// is the desktop app); programs without an"
        " origin always may",
    )
    grants: tuple[Grant, ...] | None = Field(None, max_length=2, description=GRANTS)
    allow_insecure_network: bool = Field(
        False, description="Listen beyond loopback: everyone there may then publish"
    )

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if not self.enabled:
            return self
        need("foxglove", "foxglove", "the endpoint needs the library foxglove-sdk")
        if not is_loopback(self.host) and not self.allow_insecure_network:
            raise ValueError(
                f"host '{self.host}' is reachable from the network, where everyone may then publish"
                f" set-points: listen on 127.0.0.1, or set allow_insecure_network: true"
            )
        return self

    @property
    def door(self) -> DoorRule:
        """What viewers may do."""
        who = ("Foxglove", "page:foxglove", "foxglove.grants")
        return DoorRule(*who, self.enabled, WRITING, self.grants)
