"""Pauses of a recorder: what the machine did then is unknown, so a segment ends there."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from hilserver.arrays import Array
from hilserver.measured.data import Channel, MeasuredLog, Span
from hilserver.measured.names import is_input
from hilserver.measured.thresholds import JUMP_S, PAUSE_S, USUAL_STEPS

Pieces = list[tuple[float, float]]
"""Begin and end of every part of a span that is kept, in order [s]."""


def without_jumps(log: MeasuredLog) -> MeasuredLog:
    """Return the log with gaps of more than `JUMP_S` between spans shortened to a pause."""
    moved_s = np.zeros(len(log.spans))
    for i, (before, after) in enumerate(pairwise(log.spans)):
        gap_s = after.start_s - before.end_s
        moved_s[i + 1] = moved_s[i] + (gap_s - PAUSE_S if gap_s > JUMP_S else 0.0)
    if not moved_s.any():
        return log
    spans = tuple(
        replace(span, start_s=span.start_s - by_s, end_s=span.end_s - by_s)
        for span, by_s in zip(log.spans, moved_s.tolist(), strict=True)
    )
    channels = {
        name: replace(channel, t_s=channel.t_s - moved_s[channel.span])
        for name, channel in log.channels.items()
    }
    note = (
        f"the clock jumps by {moved_s[-1]:.4g} s in total: the time stamps after a jump were"
        " shifted to continue from the last one before it"
    )
    return replace(log, channels=channels, spans=spans, notices=(*log.notices, note))


def cut_at_pauses(log: MeasuredLog) -> MeasuredLog:
    """Return the log with segments that end where nothing was measured for long."""
    edges = [_edges(log, index) for index in range(len(log.spans))]
    if all(len(of_span) == 1 for of_span in edges):
        return log
    return replace(cut(log, edges), notices=(*log.notices, _note(log.spans, edges)))


def cut(log: MeasuredLog, edges: list[Pieces]) -> MeasuredLog:
    """Return the log with the pieces of each span as separate spans."""
    pieces = [
        replace(span, start_s=start_s, end_s=end_s)
        for span, of_span in zip(log.spans, edges, strict=True)
        for start_s, end_s in of_span
    ]
    spans = tuple(replace(span, number=number) for number, span in enumerate(pieces))
    channels = {
        name: _cut(name, channel, edges) for name, channel in log.channels.items()
    }
    return replace(log, channels=channels, spans=spans)


def _edges(log: MeasuredLog, index: int) -> Pieces:
    """Return begin and end of each uninterrupted measurement; one pair if there is no pause."""
    span = log.spans[index]
    stamps = [c.of(index)[0] for name, c in log.channels.items() if not is_input(name)]
    at = np.unique(np.concatenate([np.zeros(0), *stamps]))
    steps = np.diff(at)
    if not len(steps):
        return [(span.start_s, span.end_s)]
    ends = np.flatnonzero(steps > max(PAUSE_S, USUAL_STEPS * float(np.median(steps))))
    begins = [span.start_s, *at[ends + 1].tolist()]
    return list(zip(begins, [*at[ends].tolist(), span.end_s], strict=True))


def _cut(name: str, channel: Channel, edges: list[Pieces]) -> Channel:
    parts: list[tuple[Array, Array]] = []
    for index, of_span in enumerate(edges):
        t_s, values = channel.of(index)
        for start_s, end_s in of_span:
            low, high = (
                np.searchsorted(t_s, start_s),
                np.searchsorted(t_s, end_s, side="right"),
            )
            t, v = t_s[low:high], values[low:high]
            if is_input(name) and low > 0 and not (len(t) and t[0] == start_s):
                # a set-point that was sent before still holds
                t, v = np.append(start_s, t), np.append(values[low - 1], v)
            parts.append((t, v))
    return Channel(
        np.concatenate([t for t, _ in parts]),
        np.concatenate([v for _, v in parts]),
        np.repeat(np.arange(len(parts)), [len(t) for t, _ in parts]),
    )


def _note(spans: tuple[Span, ...], edges: list[Pieces]) -> str:
    pauses = [
        (after - before, before)
        for of_span in edges
        for (_, before), (after, _) in pairwise(of_span)
    ]
    longest_s, at_s = max(pauses)
    times = "once, for" if len(pauses) == 1 else f"{len(pauses)} times, the longest for"
    return (
        f"the recording pauses {times} {longest_s:.4g} s after t_s = {at_s:.10g}: it was cut into"
        f" {len(spans) + len(pauses)} segments, each with a start pose of its own"
    )
