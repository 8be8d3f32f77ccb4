"""The step of one configuration: plant, sensors and own blocks between latch and publication.

This is the only room that knows both the plant's arrays and where they lie in the process image.
"""

from hilserver.kernel.build import compose, limit_silence, watch_communication
from hilserver.kernel.composition import BlockUse, Composition, Part

__all__ = ["BlockUse", "Composition", "Part", "compose", "limit_silence", "watch_communication"]
