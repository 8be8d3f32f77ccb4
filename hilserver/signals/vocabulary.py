"""Words that signals, states and sources of commands share."""

from enum import IntEnum
from typing import Literal

RESERVED = frozenset(
    ("robot", "methods", "slices", "peers", "audit", "faults", "parameters", "internal")
)
"""First parts of names that belong to the daemon itself; no block may have them."""

LIGHTS = (
    "off",
    "dim",
    "high beam",
    "flash all",
    "flash left",
    "flash right",
    "pulsation",
    "rotation",
    "running",
)
COLOURS = ("red", "green", "blue")


class State(IntEnum):
    """States of the daemon; the numbers are those of ``sim.state``."""

    STARTING = 0
    RUNNING = 1
    PAUSED = 2
    SAFE = 3
    STOPPING = 4

    @property
    def word(self) -> str:
        """As metrics, logs and messages show it: ``running``."""
        return self.name.lower()


ESTIMATE_STATES = ("no fix", "converging", "tracking", "dead reckoning")
"""Values of ``estimate.state``."""

Source = Literal["scenario", "page", "opcua", "shield", "ros2", "peer"]
SOURCES: tuple[Source, ...] = ("scenario", "page", "opcua", "shield", "ros2", "peer")
"""Kinds of sources that may command, in the default order of priority (highest first)."""

MEASURED = "measured."  # beginning of the names under which values of the real robot come in
SAMPLED = ("wheel", "imu", "nav")  # groups of them whose samples are counted
