"""Quality of service, as far as robots' ROS 2 nodes use it."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class Qos:
    """Reliability, durability and depth of one writer or reader; KEEP_LAST always."""

    reliable: bool = True
    latched: bool = False
    depth: int = 10


DEFAULT: Final = Qos()  # of a writer with `SystemDefaultsQoS`
# for readers: BEST_EFFORT matches every writer
SENSOR_DATA: Final = Qos(reliable=False)
LATCHED: Final = Qos(latched=True, depth=1)
"""RELIABLE and TRANSIENT_LOCAL: a late reader gets the last message."""
