"""Segments of a log on the plant's ticks."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from hilserver.arrays import Array, Indices
from hilserver.measured.data import MeasuredLog
from hilserver.measured.thresholds import SHORTEST_SEGMENT_S


@dataclass(frozen=True)
class Segments:
    """The position of each segment in time and in the dense arrays."""

    span: Indices  # shape (m,); span of the log that it is cut from
    # shape (m,)
    start_s: Array
    end_s: Array
    # shape (m + 1,); first row of each segment in the dense arrays, and the end
    first: Indices
    period_s: float  # time between rows
    # the dense arrays begin this long before the segment: what comes late began then
    lead_s: float = 0.0

    def __len__(self) -> int:
        return len(self.span)

    @property
    def ticks(self) -> int:
        """Rows of the dense arrays."""
        return int(self.first[-1])

    @property
    def longest_s(self) -> float:
        """Length of the longest segment; 0 without any."""
        return float((self.end_s - self.start_s).max(initial=0.0))

    def times(self, index: int) -> Array:
        """Return the times of the rows of a segment."""
        n = int(self.first[index + 1] - self.first[index])
        return np.asarray(
            self.start_s[index] - self.lead_s + self.period_s * np.arange(n)
        )

    def locate(self, span: Indices, t_s: Array) -> tuple[Indices, Array]:
        """Return the segment of each sample (-1: none) and its row as a fraction."""
        segment = np.full(len(t_s), -1, dtype=np.int64)
        at = np.zeros(len(t_s))
        for i in range(len(self)):
            low, high = np.searchsorted(span, [self.span[i], self.span[i] + 1])
            t = t_s[low:high]
            a, b = low + np.searchsorted(
                t, [self.start_s[i] - 1e-9, self.end_s[i] - 1e-9]
            )
            segment[a:b] = i
            since_s = t_s[a:b] - self.start_s[i] + self.lead_s
            at[a:b] = self.first[i] + since_s / self.period_s
        return segment, at


def cut(
    log: MeasuredLog, period_s: float, longest_s: float | None, lead_s: float = 0.0
) -> Segments:
    """Cut the spans of a log into segments of equal length, at most `longest_s`."""
    span: list[int] = []
    edges: list[tuple[float, float]] = []
    for i, s in enumerate(log.spans):
        length = s.end_s - s.start_s
        if length < SHORTEST_SEGMENT_S:
            continue
        n = 1 if longest_s is None else max(1, int(np.ceil(length / longest_s - 1e-9)))
        since = length / n * np.arange(n + 1)
        if log.on_ticks:  # so that samples lie on rows of the dense arrays
            since = period_s * np.rint(since / period_s)
        span += [i] * n
        edges += pairwise([*(s.start_s + since[:-1]).tolist(), s.end_s + period_s])
    start, end_s = (
        (np.array(e) for e in zip(*edges, strict=True)) if edges else ([], [])
    )
    lead_s = period_s * round(lead_s / period_s)
    length = np.asarray(end_s) - np.asarray(start) + lead_s
    ticks = np.ceil(length / period_s).astype(np.int64) + 2
    first = np.concatenate([[0], np.cumsum(ticks)]).astype(np.int64)
    return Segments(
        np.array(span, dtype=np.int64),
        np.asarray(start),
        np.asarray(end_s),
        first,
        period_s,
        lead_s,
    )
