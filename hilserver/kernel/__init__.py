"""The step of one configuration: plant, sensors and own blocks between latch and publication.

This is the only room that knows both the plant's arrays and where they lie in the process image.
"""

from hilserver.kernel.compose import (
    BlockUse,
    Composition,
    Part,
    compose,
    limit_silence,
    watch_communication,
)

__all__ = ["BlockUse", "Composition", "Part", "compose", "limit_silence", "watch_communication"]
