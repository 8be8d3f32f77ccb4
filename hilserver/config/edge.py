"""The section ``edge:``: signals on the databus of a Siemens Industrial Edge device."""

from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from hilserver.config.doors import GRANTS, WRITING, DoorRule, Grant
from hilserver.config.section import Driver, LinkSection, Section, need

# one level of a topic
Level = Annotated[str, StringConstraints(pattern=r"^[A-Za-z0-9_.-]{1,64}$")]


class EdgeGroup(Section):
    """Signals that are published together: a collection of data points."""

    name: Level = Field("signals", description="Last level of the group's topics")
    signals: tuple[
        Annotated[str, StringConstraints(min_length=1, max_length=100)], ...
    ] = Field(
        ("*",),
        min_length=1,
        max_length=1000,
        description="Signals, by name or as wheel.*.speed_rpm",
    )
    rate_hz: float = Field(10.0, ge=0.01, le=100, description="Messages a second")
    writable: bool = Field(
        False, description="Accept values for those signals that are inputs"
    )


class EdgeTls(Section):
    """Encryption; the broker's certificate and name are always checked."""

    ca: Path | None = Field(
        None, description="Certificates to trust; null: those of the system"
    )
    certificate: Path | None = Field(
        None, description="Our certificate, if the broker wants one"
    )
    key: Path | None = Field(None, description="Private key of our certificate")

    @model_validator(mode="after")
    def _whole(self) -> Self:
        if (self.certificate is None) != (self.key is None):
            raise ValueError(
                "certificate and key belong together: name both or neither"
            )
        return self


class EdgeConfig(LinkSection):
    """Signals on the databus: MQTT in the common payload format (extra edge)."""

    enabled: bool = Field(False, description="Connect to the broker")
    host: str = Field(
        "ie-databus", min_length=1, max_length=253, description="The broker"
    )
    port: int = Field(1883, ge=1, le=65535, description="8883 is usual with TLS")
    id: Level = Field(
        "hilserver", description="Application instance, a level of all topics"
    )
    connection: Level = Field(
        "robot", description="Name of the connection, a level of all topics"
    )
    user: str | None = Field(
        None, min_length=1, max_length=100, description="User at the broker"
    )
    password_file: Path | None = Field(
        None, description="File whose first line is the password"
    )
    tls: EdgeTls | None = Field(None, description="Encrypt; null: plain TCP")
    version: Literal["3.1.1", "5"] = Field("3.1.1", description="Of MQTT")
    qos: Literal[0, 1] = Field(0, description="1: the broker confirms every message")
    groups: tuple[EdgeGroup, ...] = Field((EdgeGroup(),), min_length=1, max_length=100)
    grants: tuple[Grant, ...] | None = Field(
        None, max_length=2, description=f"{GRANTS}; only signals of writable groups"
    )
    stale_after_ms: float = Field(
        2000.0, ge=100, le=3_600_000, description="Values older than this are stale"
    )
    on_stale: Literal["hold", "zero", "ramp"] = Field(
        "ramp", description="What then happens to set-points from the databus"
    )

    @model_validator(mode="after")
    def _usable(self) -> Self:
        if self.enabled:
            need("aiomqtt", "edge", "the databus needs the library aiomqtt")
        names = [group.name for group in self.groups]
        for name in names:
            if names.count(name) > 1:
                raise ValueError(f"two groups have the name '{name}'; rename one")
        if self.password_file is not None and self.user is None:
            raise ValueError("password_file: name the user as well")
        return self

    @property
    def drives(self) -> bool:
        """Whether it accepts values."""
        return self.enabled and any(group.writable for group in self.groups)

    @property
    def driver(self) -> Driver:
        """The writers on the databus."""
        who = ("edge", "peer:edge", "the databus")
        return Driver(
            *who, self.stale_after_ms, self.on_stale, self.drives, has_faults=False
        )

    @property
    def door(self) -> DoorRule:
        """What other clients of the broker may do."""
        who = ("databus", self.driver.source, "edge.grants")
        return DoorRule(*who, self.drives, WRITING, self.grants)

    def about(self, _folder: Path) -> str:
        """Return the address of the broker."""
        return f"mqtt://{self.host}:{self.port}" if self.enabled else ""
