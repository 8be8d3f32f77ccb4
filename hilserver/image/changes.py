"""The queue of parameter changes for the step, which recorders read as well.

The region is a queue with one producer, the event loop, and one consumer, the latch. A row holds
all parameters, packed, so that nothing is computed on the paced path. Rows stay readable after the
consumer took them, for as many changes as half of the queue holds.
"""

from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled import kernel
from hilserver.compiled.atomics import store_release
from hilserver.image import word
from hilserver.image.reader import ImageReader

REGION: Final = "parameter_mail"
ROWS: Final = 64  # a power of two
MOST_WAITING: Final = ROWS // 2

# --- a row: its head, then the packed numbers -----------------------------------------------------
NUMBER: Final = 0  # of the change; 0 while it is being written
DUE: Final = 1  # first tick in which it may act
TAKEN: Final = 2  # tick in which it has acted, -1 before
PACKED: Final = 4
NOW: Final = -1


def words_needed(packed: int) -> int:
    """Return the length of the region [words] for changes of `packed` numbers each."""
    return ROWS * (PACKED + packed)


@kernel("void(int64, int64[::1])")
def show_changes(head: int, words: Any) -> None:
    """Make all rows before `head` visible to the plant, at once."""
    store_release(words, word.CHANGES_HEAD, head)


class Changes:
    """The queue from Python: the daemon posts, a recorder reads."""

    def __init__(self, image: ImageReader) -> None:
        self._image = image
        values, words = image.region(REGION)
        self._values, self._words = values.reshape(ROWS, -1), words.reshape(ROWS, -1)

    @property
    def length(self) -> int:
        """Numbers in a packed change."""
        return self._words.shape[1] - PACKED

    @property
    def room(self) -> int:
        """How many changes can be posted now."""
        control = self._image.control
        return MOST_WAITING - (control.changes_head - control.changes_tail)

    def post(self, number: int, packed: NDArray[np.float64], due: int = NOW) -> bool:
        """Post a change to the plant; False if too many wait already.

        Parameters
        ----------
        number : int
            Number of the change, above 0; `internal.edition` shows it once it acts.
        packed : ndarray of float64, shape (length,)
        due : int
            First tick in which it may act; changes behind it wait, too.
        """
        if self.room < 1:
            return False
        head = self._image.control.changes_head
        row = self._words[head & (ROWS - 1)]
        # `find` looks again after its copy: a row that changed meanwhile is none
        row[NUMBER] = 0
        row[DUE], row[TAKEN] = due, -1
        self._values[head & (ROWS - 1), PACKED:] = packed
        row[NUMBER] = number
        show_changes(head + 1, self._image.words)
        return True

    def tick_of(self, number: int) -> int | None:
        """Return the tick in which change `number` has acted; None before."""
        found = np.flatnonzero(
            (self._words[:, NUMBER] == number) & (self._words[:, TAKEN] >= 0)
        )
        return int(self._words[found[0], TAKEN]) if found.size else None

    def find(self, number: int, tick: int) -> NDArray[np.float64] | None:
        """Return the packed numbers of change `number` that acted in `tick`; None if not there."""
        found = np.flatnonzero(
            (self._words[:, NUMBER] == number) & (self._words[:, TAKEN] == tick)
        )
        for row in found.tolist():
            packed: NDArray[np.float64] = self._values[row, PACKED:].copy()
            if self._words[row, NUMBER] == number:
                return packed
        return None
