"""Which part of a long drive is shown."""

from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.measured.clock import cut
from hilserver.measured.thresholds import LONGEST_SEGMENT_S
from reference.scenarios.views.case import Case

NEARLY_LARGEST: Final = 0.98
"""Of stretches whose difference is so nearly the largest the middle one is shown."""


def stretch(
    case: Case, channel: str, t_s: Array, difference: Array, length_s: float
) -> tuple[float, float]:
    """Return the stretch of a given length in which a difference is largest.

    A simulated pose starts anew in every segment, so that its stretch lies within one.
    """
    longest = None if channel.startswith("wheel") else LONGEST_SEGMENT_S
    segments = cut(case.log, case.robot.period_s, longest)
    per_s = (len(t_s) - 1) / (t_s[-1] - t_s[0])
    n = max(round(length_s * per_s), 2)
    squares = np.nan_to_num(difference) ** 2
    best, found = -1.0, (float(t_s[0]), float(t_s[-1]))
    for begin, end in zip(segments.start_s, segments.end_s, strict=True):
        rows = np.flatnonzero((t_s >= begin) & (t_s < end))
        if len(rows) < 2:
            continue
        sums = np.convolve(squares[rows], np.ones(min(n, len(rows))), "valid")
        k = int(np.argmax(sums))
        if sums[k] > best:
            best = float(sums[k])
            around = slice(max(k - n, 0), k + n)
            k = around.start + int(
                np.median(np.flatnonzero(sums[around] >= NEARLY_LARGEST * best))
            )
            last = rows[min(k + n, len(rows)) - 1]
            found = (float(t_s[rows[k]]), float(t_s[last]))
    return found
