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
        is_jump = gap_s > JUMP_S
        moved_s[i + 1] = moved_s[i] + (gap_s - PAUSE_S if is_jump else 0.0)
    if not moved_s.any():
        return log

    spans = []
    for span, by_s in zip(log.spans, moved_s.tolist(), strict=True):
        start_s = span.start_s - by_s
        end_s = span.end_s - by_s
        spans.append(replace(span, start_s=start_s, end_s=end_s))
    channels = {}
    for name, channel in log.channels.items():
        t_s = channel.t_s - moved_s[channel.span]
        channels[name] = replace(channel, t_s=t_s)
    note = (
        f"the clock jumps by {moved_s[-1]:.4g} s in total: the time stamps after a jump were"
        " shifted to continue from the last one before it"
    )
    notices = (*log.notices, note)
    return replace(log, channels=channels, spans=tuple(spans), notices=notices)


def cut_at_pauses(log: MeasuredLog) -> MeasuredLog:
    """Return the log with segments that end where nothing was measured for long."""
    edges = [_edges(log, index) for index in range(len(log.spans))]
    if all(len(of_span) == 1 for of_span in edges):
        return log
    pauses: list[tuple[float, float]] = []
    for of_span in edges:
        for (_, before_s), (after_s, _) in pairwise(of_span):
            pauses.append((after_s - before_s, before_s))
    longest_s, at_s = max(pauses)
    times = "once, for" if len(pauses) == 1 else f"{len(pauses)} times, the longest for"
    note = (
        f"the recording pauses {times} {longest_s:.4g} s after t_s = {at_s:.10g}: it was cut into"
        f" {len(log.spans) + len(pauses)} segments, each with a start pose of its own"
    )
    return replace(cut(log, edges), notices=(*log.notices, note))


def cut(log: MeasuredLog, edges: list[Pieces]) -> MeasuredLog:
    """Return the log with the pieces of each span as separate spans."""
    spans: list[Span] = []
    for span, of_span in zip(log.spans, edges, strict=True):
        for start_s, end_s in of_span:
            number = span.number_recorded
            spans.append(Span(len(spans), span.block, start_s, end_s, number))
    channels = {
        name: _cut(name, channel, edges) for name, channel in log.channels.items()
    }
    return replace(log, channels=channels, spans=tuple(spans))


def _edges(log: MeasuredLog, index: int) -> Pieces:
    """Return begin and end of each uninterrupted measurement; one pair if there is no pause."""
    span = log.spans[index]
    measured = [c for name, c in log.channels.items() if not is_input(name)]
    stamps = [channel.of(index)[0] for channel in measured]
    at_s = np.unique(np.concatenate([np.zeros(0), *stamps]))
    steps_s = np.diff(at_s)
    if not len(steps_s):
        return [(span.start_s, span.end_s)]
    longest_s = max(PAUSE_S, USUAL_STEPS * float(np.median(steps_s)))
    last = np.flatnonzero(steps_s > longest_s)
    begins_s = [span.start_s, *at_s[last + 1].tolist()]
    ends_s = [*at_s[last].tolist(), span.end_s]
    return list(zip(begins_s, ends_s, strict=True))


def _cut(name: str, channel: Channel, edges: list[Pieces]) -> Channel:
    parts: list[tuple[Array, Array]] = []
    for index, of_span in enumerate(edges):
        t_s, values = channel.of(index)
        for start_s, end_s in of_span:
            low = np.searchsorted(t_s, start_s)
            high = np.searchsorted(t_s, end_s, side="right")
            t = t_s[low:high]
            v = values[low:high]
            begins_at_start = len(t) and t[0] == start_s
            if is_input(name) and low > 0 and not begins_at_start:
                # a set-point that was sent before still holds
                t = np.append(start_s, t)
                v = np.append(values[low - 1], v)
            parts.append((t, v))
    lengths = [len(t) for t, _ in parts]
    t_s = np.concatenate([t for t, _ in parts])
    values = np.concatenate([v for _, v in parts])
    return Channel(t_s, values, np.repeat(np.arange(len(parts)), lengths))
