"""The section ``shield:``: the robot's extension shield on a serial line."""

from pathlib import Path
from typing import Final, Literal

from pydantic import Field, field_validator

from hilserver.config.section import Driver, LinkSection
from hilserver.plant.layout import N_WHEELS, WHEELS

Variant = Literal["iotbot", "crc"]
CHANNELS: Final[dict[Variant, tuple[str, ...]]] = {
    "iotbot": ("rr", "fr", "rl", "fl"),
    "crc": ("fl", "fr", "rl", "rr"),
}
"""Wheel on each motor channel, by variant."""


class ShieldConfig(LinkSection):
    """The shield that a robot's own driver speaks to, on a pseudo-terminal or a serial line."""

    enabled: bool = Field(False, description="Answer as the extension shield does")
    link: Path = Field(
        Path("runtime/shield"),
        description="Symbolic link to the pseudo-terminal that the daemon creates; relative to this"
        " file",
    )
    device: Path | None = Field(
        None, description="A serial line instead, such as /dev/ttyS1; it must exist"
    )
    variant: Variant = Field(
        "iotbot",
        description="iotbot: answers of 32 bytes; crc: of 33, requests are checked",
    )
    channels: tuple[str, ...] | None = Field(
        None,
        description="Wheels on the channels 0 to 3; null: by variant, rr fr rl fl or fl fr rl rr",
    )
    reply_delay_ms: float = Field(
        1.0,
        ge=0,
        le=100,
        description="End of the request to first byte of the response",
    )
    pace: bool = Field(True, description="Send no byte earlier than 115200 baud allows")
    parameters: Literal["store", "apply"] = Field(
        "store",
        description="kp, ki, gear ratio and others: only stored and shown, or applied as gains",
    )
    stale_after_ms: float = Field(
        1000.0,
        gt=0,
        le=1e6,
        description="Silence of the host after which on_stale applies",
    )
    on_stale: Literal["device", "ramp"] = Field(
        "device",
        description="device: enable is withdrawn until the host sends again; ramp: safe state",
    )

    @field_validator("channels")
    @classmethod
    def _every_wheel_once(cls, value: tuple[str, ...] | None) -> tuple[str, ...] | None:
        if value is not None and (len(value) != N_WHEELS or set(value) != set(WHEELS)):
            raise ValueError(f"name each of {', '.join(WHEELS)} once, channel 0 first")
        return value

    @property
    def driver(self) -> Driver:
        """The host."""
        who = ("shield", "shield", "the shield's host")
        return Driver(
            *who, self.stale_after_ms, self.on_stale, self.enabled, has_faults=False
        )

    def about(self, folder: Path) -> str:
        """Return the serial line."""
        if self.enabled:
            return str(self.device or folder / self.link)
        return ""

    @property
    def wheels(self) -> tuple[str, ...]:
        """Wheel on each motor channel."""
        return self.channels or CHANNELS[self.variant]
