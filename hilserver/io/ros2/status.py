"""What is known about ROS 2: a peer's status with additions."""

import time
from dataclasses import dataclass
from enum import StrEnum

from hilserver.io.link_status import PeerStatus


class Ros2Fault(StrEnum):
    """Ways in which what others send, or that they send it, can be wrong."""

    BAD_MESSAGE = "bad_message"
    SAMPLE_LOST = "sample_lost"
    INCOMPATIBLE_QOS = "incompatible_qos"
    NOT_TAKEN = "not_taken"
    ALSO_PUBLISHED = "also_published"


class CommandState(StrEnum):
    """Where the last command stands."""

    NONE = "none"
    FRESH = "fresh"
    HELD = "held"  # older than `stale_after_ms`; its writer is alive
    STALE = "stale"


@dataclass(slots=True)
class Ros2Status(PeerStatus):
    """Everything observed in the domain."""

    command: CommandState = CommandState.NONE
    command_ns: int | None = None  # CLOCK_MONOTONIC [ns] of the newest accepted command
    # the participant that sent it counts as alive for so long
    lease_s: float | None = None
    participants: int = 0  # others in the domain
    strangers: int = 0  # those of them with which no topic matches
    apart: int = 0  # endpoints of the right name that do not fit

    def command_age_s(self, now_ns: int) -> float | None:
        """Return the age of the newest command [s]; None before the first."""
        return None if self.command_ns is None else (now_ns - self.command_ns) * 1e-9

    @property
    def figures(self) -> dict[str, float | str | bool | int | None]:
        """What OPC UA shows in addition to a peer's figures."""
        return {
            "command": str(self.command),
            "command_age_s": self.command_age_s(time.monotonic_ns()),
            "lease_s": self.lease_s,
            "participants": self.participants,
            "strangers": self.strangers,
            "apart": self.apart,
        }
