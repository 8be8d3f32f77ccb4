"""The control words in Python: plain attributes of an image."""

import numpy as np
from numpy.typing import NDArray

from hilserver.image import word


class ControlWords:
    """What daemon and plant exchange besides signals; ``STATE`` in `word` is the attribute `state`.

    Setting a word of a read-only arena raises a ValueError.
    """

    words: NDArray[np.int64]

    def __init__(self, words: NDArray[np.int64]) -> None:
        object.__setattr__(self, "words", words)

    def __getattr__(self, name: str) -> int:
        return int(self.words[getattr(word, name.upper())])

    def __setattr__(self, name: str, value: int) -> None:
        self.words[getattr(word, name.upper())] = value
