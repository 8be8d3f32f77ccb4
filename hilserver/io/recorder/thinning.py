"""Leaves out frames in which nothing changes, as signals from outside change only now and then.

Kept are frames in which a recorded signal changes, the frame before each (which shows that the
old value lasted until then), and one of every `LEAST_EVERY`, so that silence shows.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.image import FrameBatch
from hilserver.logs.writer import Segmented

LEAST_EVERY: Final = 100  # ticks


class Thinner:
    """Thins successive batches; the last frame of one waits for the next."""

    def __init__(self, slots: Sequence[int]) -> None:
        self._slots = np.array(slots, dtype=np.intp)
        self._held: Segmented | None = None
        self._is_kept = True  # whether the waiting frame is kept regardless of the next

    def thinned(self, batch: Segmented) -> Segmented:
        """Return the frames to write, up to the one before the newest; possibly none."""
        whole = batch if self._held is None else _joined(self._held, batch)
        # As bits, NaN equals itself.
        bits = whole.frames.values[:, self._slots].view(np.int64)
        codes = whole.frames.status[:, self._slots]
        seen = np.concatenate(
            [bits, codes],
            axis=1,
        )
        changed = np.full(len(seen), self._is_kept)
        changed[1:] = (seen[1:] != seen[:-1]).any(axis=1)
        changed[1:] |= np.diff(whole.segments) != 0
        kept = changed | (whole.frames.ticks % LEAST_EVERY == 0)
        kept[:-1] |= changed[1:]
        self._is_kept = bool(kept[-1])
        kept[-1] = False
        self._held = _some(whole, np.arange(len(kept)) == len(kept) - 1)
        return replace(_some(whole, kept), changes=batch.changes)


def _joined(held: Segmented, batch: Segmented) -> Segmented:
    words = np.concatenate([held.frames.words, batch.frames.words])
    values = np.concatenate([held.frames.values, batch.frames.values])
    segments = np.concatenate([held.segments, batch.segments])
    return Segmented(FrameBatch(held.frames.first, words, values), segments)


def _some(batch: Segmented, rows: NDArray[np.bool_]) -> Segmented:
    return Segmented(batch.frames.kept(rows), batch.segments[rows])
