"""The compiled step of one configuration: plant, sensors and own blocks from latch to publication.

This is the only room that knows both the plant's arrays and their places in the process image.
"""

from hilserver.kernel.build import compose, limit_silence, watch_communication
from hilserver.kernel.composition import BlockUse, Composition, RobotPart

__all__ = [
    "BlockUse",
    "Composition",
    "RobotPart",
    "compose",
    "limit_silence",
    "watch_communication",
]
