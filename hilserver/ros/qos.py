"""Quality of service, as far as ROS 2 nodes of robots use it."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Qos:
    """Reliability, durability and depth of one writer or reader; KEEP_LAST always."""

    reliable: bool = True
    latched: bool = False
    depth: int = 10


DEFAULT: Final = Qos()  # what `SystemDefaultsQoS` of a writer gives
SENSOR_DATA: Final = Qos(reliable=False)  # readers take it: BEST_EFFORT matches every writer
LATCHED: Final = Qos(latched=True, depth=1)
"""RELIABLE and TRANSIENT_LOCAL: who comes late gets the last one."""
