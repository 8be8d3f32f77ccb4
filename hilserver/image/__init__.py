"""The process image: one shared-memory arena between the plant and everything else, as in a PLC.

Inputs are latched at the start of a tick, outputs are published at its end. Neither side waits: the
plant writes complete frames into a ring, of which readers take the newest; sources push rows into
queues that the plant drains at the next tick.
"""

from typing import TYPE_CHECKING

from hilserver.image.reader import Frame, FrameBatch, ImageReader, read_frames, to_batch
from hilserver.image.stop import press_stop
from hilserver.lazily import lazily

if TYPE_CHECKING:
    from hilserver.image.process_image import ProcessImage, Row
else:
    __getattr__ = lazily(__name__, process_image=("ProcessImage", "Row"))

__all__ = [
    "Frame",
    "FrameBatch",
    "ImageReader",
    "ProcessImage",
    "Row",
    "press_stop",
    "read_frames",
    "to_batch",
]
