"""Words that signals, states and sources of commands share."""

from enum import IntEnum
from typing import Literal

RESERVED = frozenset(
    ("robot", "methods", "slices", "peers", "audit", "faults", "parameters", "internal")
)
"""First parts of names that are reserved for the daemon itself; blocks may not use them."""

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
        """The word in metrics, logs and messages: ``running``."""
        return self.name.lower()


ESTIMATE_STATES = ("no fix", "converging", "tracking", "dead reckoning")
"""Values of ``estimate.state``."""

Source = Literal["scenario", "page", "opcua", "shield", "ros2", "peer"]
SOURCES: tuple[Source, ...] = ("scenario", "page", "opcua", "shield", "ros2", "peer")
"""Kinds of sources that may command, in the default order of priority (highest first)."""
AUTOMATIC = frozenset({"opcua", "shield", "ros2", "peer"})
"""Those that drive without a person, hands among them excepted; a scenario is started."""

MEASURED = "measured."  # prefix of the names of values from the real robot
SAMPLED = ("wheel", "imu", "nav")  # groups of these whose samples are counted
