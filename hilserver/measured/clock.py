"""Segments of a log on the plant's ticks."""

from dataclasses import dataclass

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
        first, end = self.first[index : index + 2]
        begin_s = self.start_s[index] - self.lead_s
        return np.asarray(begin_s + self.period_s * np.arange(end - first))

    def locate(self, span: Indices, t_s: Array) -> tuple[Indices, Array]:
        """Return the segment of each sample (-1: none) and its row as a fraction."""
        segment = np.full(len(t_s), -1, dtype=np.int64)
        at = np.zeros(len(t_s))
        for i, (own, start_s, end_s) in enumerate(
            zip(self.span, self.start_s, self.end_s, strict=True)
        ):
            low, high = np.searchsorted(span, [own, own + 1])
            edges_s = [start_s - 1e-9, end_s - 1e-9]
            a, b = low + np.searchsorted(t_s[low:high], edges_s)
            segment[a:b] = i
            since_s = t_s[a:b] - start_s + self.lead_s
            at[a:b] = self.first[i] + since_s / self.period_s
        return segment, at


def cut(
    log: MeasuredLog, period_s: float, longest_s: float | None, lead_s: float = 0.0
) -> Segments:
    """Cut the spans of a log into segments of equal length, at most `longest_s`."""
    span: list[int] = []
    starts_s: list[float] = []
    ends_s: list[float] = []
    for i, s in enumerate(log.spans):
        length_s = s.end_s - s.start_s
        if length_s < SHORTEST_SEGMENT_S:
            continue
        n = 1
        if longest_s is not None:
            n = max(1, int(np.ceil(length_s / longest_s - 1e-9)))
        since_s = length_s / n * np.arange(n)
        if log.on_ticks:  # so that samples lie on rows of the dense arrays
            since_s = period_s * np.rint(since_s / period_s)
        begins_s = (s.start_s + since_s).tolist()
        span += [i] * n
        starts_s += begins_s
        ends_s += [*begins_s[1:], s.end_s + period_s]

    start_s = np.array(starts_s)
    end_s = np.array(ends_s)
    lead_s = period_s * round(lead_s / period_s)
    length = end_s - start_s + lead_s
    ticks = np.ceil(length / period_s).astype(np.int64) + 2
    first = np.append(0, np.cumsum(ticks)).astype(np.int64)
    of_span = np.array(span, dtype=np.int64)
    return Segments(of_span, start_s, end_s, first, period_s, lead_s)
