"""The section ``shared_memory:``: programs on this computer that write into the robot."""

from pathlib import Path
from typing import Literal

from pydantic import Field

from hilserver.config.doors import DoorRule, Grant
from hilserver.config.section import Driver, LinkSection


class SharedMemoryConfig(LinkSection):
    """Programs of this computer that share memory; the outputs can always be read."""

    grants: tuple[Grant, ...] = Field(
        (),
        max_length=2,
        description="What a program may write: measured.*, command; empty: it only reads",
    )
    poll_ms: float = Field(
        2.0,
        ge=1,
        le=1000,
        description="How often to look whether a program has written",
    )
    stale_after_ms: float = Field(
        500.0, ge=10, le=3_600_000, description="Values older than this are stale"
    )
    on_stale: Literal["hold", "zero", "ramp"] = Field(
        "ramp", description="What then happens to the set-points of the program"
    )

    @property
    def drives(self) -> bool:
        """Whether a program may command."""
        return "command" in self.grants

    @property
    def driver(self) -> Driver:
        """The program that writes."""
        who = ("memory", "peer:memory", "the program in shared memory")
        is_open = bool(self.grants)
        return Driver(
            *who, self.stale_after_ms, self.on_stale, is_open, has_faults=False
        )

    @property
    def door(self) -> DoorRule:
        """What a program may do: nothing that is not granted here."""
        who = ("shared memory", self.driver.source, "shared_memory.grants")
        return DoorRule(*who, bool(self.grants), frozenset(), self.grants)

    def about(self, _folder: Path) -> str:
        """Return what a program may write."""
        return f"a program may write {' and '.join(self.grants)}" if self.grants else ""
