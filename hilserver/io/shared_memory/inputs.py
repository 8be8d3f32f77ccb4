"""What a program writes: a counter and a number per input, in the order of the signal table.

The program makes the counter odd, writes, and makes it even again. A NaN is an input that it leaves
to others. One that it has written before is missing from its command then, see `InputGate.write`.
"""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.image.layout import Layout, describe
from hilserver.image.reader import fence
from hilserver.image.shared_file import SharedFile
from hilserver.signals import Signal, SignalTable, ValueType

HEAD_WORDS: Final = 2
LAYOUT, COUNTER = range(HEAD_WORDS)
HEAD_END: Final = b', "regions"'
_FNV_START: Final = 0xCBF29CE484222325
_FNV_FACTOR: Final = 0x100000001B3


def name_of(image: str) -> str:
    """Return the name in shared memory of the inputs beside an image."""
    return f"{image}-inputs"


def inputs_of(table: SignalTable) -> list[Signal]:
    """Return the inputs that a program may write, in the order of their places."""
    return [signal for signal in table.scalars if signal.writable and not signal.hidden]


def layout_number(table: SignalTable) -> int:
    """Return a number for the names, types and places of a table (FNV-1a).

    Programs compute it from the head of the process image, which begins with the same text.
    """
    head, _, _ = describe(table, Layout({}, 0, 0, 0, 0), {}).partition(HEAD_END)
    number = _FNV_START
    for byte in head:
        number = (number ^ byte) * _FNV_FACTOR & 0xFFFF_FFFF_FFFF_FFFF
    return number >> 1  # positive as a signed number, too


class SharedInputs:
    """The daemon's side of the memory that a program writes.

    Attributes
    ----------
    missing : set of str
        Inputs that the program once wrote, and that are NaN in what it wrote last.
    """

    def __init__(self, image: str, table: SignalTable) -> None:
        self._signals = inputs_of(table)
        self._file = SharedFile(name_of(image), 8 * (HEAD_WORDS + len(self._signals)))
        self.path = self._file.path
        self._words: NDArray[np.int64] = np.frombuffer(self._file.map, dtype=np.int64)
        self._values = self._words[HEAD_WORDS:].view(np.float64)
        self._values[:] = np.nan
        self._seen = 0
        self._written = np.zeros(len(self._signals), dtype=bool)
        self.missing: set[str] = set()
        self._words[LAYOUT] = layout_number(table)  # last: a program waits for it

    def news(self) -> dict[str, object] | None:
        """Return what was written since the last call; None: nothing, or it is not complete."""
        counter = int(self._words[COUNTER])
        if counter == self._seen or counter % 2:
            return None
        fence()
        numbers = self._values.copy()
        fence()
        if int(self._words[COUNTER]) != counter:
            return None
        self._seen = counter
        is_number = ~np.isnan(numbers)
        self.missing = {
            self._signals[i].name for i in np.flatnonzero(self._written & ~is_number)
        }
        self._written |= is_number
        return {
            self._signals[i].name: _typed(self._signals[i], numbers[i])
            for i in np.flatnonzero(is_number)
        }

    def close(self) -> None:
        """Remove the file."""
        del self._words, self._values
        self._file.close()


def _typed(signal: Signal, number: float) -> object:
    if signal.type is ValueType.BOOLEAN and number in (0.0, 1.0):
        return bool(number)
    return float(number)
