"""The board: figures of the daemon as one JSON text in shared memory, for any process to attach.

Peers, faults, events and the like are not signals and change slowly. The daemon writes them as a
whole; a reader takes the text if its checksum fits, and otherwise tries again later.
"""

import json
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hilserver.image.reader import ImageReader

REGION = "board"
WORDS = 32_768
_HEAD_WORDS = 3  # number of the text, bytes, checksum


class Board:
    """The daemon's side: shows a new text."""

    def __init__(self, image: ImageReader) -> None:
        _, self._words = image.region(REGION)
        self._bytes = self._words[_HEAD_WORDS:].view(np.uint8)

    def show(self, content: dict[str, Any]) -> bool:
        """Replace the text; False if it is too long for the region."""
        text = json.dumps(content, allow_nan=False, separators=(",", ":")).encode()
        if len(text) > len(self._bytes):
            return False
        self._bytes[: len(text)] = np.frombuffer(text, np.uint8)
        self._words[1], self._words[2] = len(text), zlib.crc32(text)
        # Not ordered for other cores: a reader that is too early finds a wrong checksum.
        self._words[0] += 1
        return True


class BoardReader:
    """A reader's side, in any process; KeyError if the image has no board."""

    def __init__(self, reader: ImageReader) -> None:
        _, self._words = reader.region(REGION)
        self._bytes: NDArray[np.uint8] = self._words[_HEAD_WORDS:].view(np.uint8)
        self._seen = -1
        self._content: dict[str, Any] = {}

    @property
    def content(self) -> dict[str, Any]:
        """The newest complete text, empty before the first."""
        number = int(self._words[0])
        if number != self._seen:
            n_bytes, check_sum = int(self._words[1]), int(self._words[2])
            if 0 < n_bytes <= len(self._bytes):
                text = self._bytes[:n_bytes].tobytes()
                if zlib.crc32(text) == check_sum:
                    self._content, self._seen = json.loads(text), number
        return self._content
