"""All samples of one stage in one vector: by channel, then by segment, then by time."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.arrays import Array, Indices, Mask
from hilserver.measured.clock import Segments
from hilserver.measured.data import MeasuredLog

FOLD_RUNS: Final = 6  # with this many runs, or else segments, they are held out whole


@dataclass(frozen=True)
class Stack:
    """The measured samples of one stage."""

    channels: tuple[str, ...]
    edges: Mapping[str, slice]  # position of each channel
    segment: Indices  # shape (n,)
    # shape (n,)
    t_s: Array
    values: Array
    at: Array  # shape (n,): row in the dense arrays, as a fraction
    # shape (n,): first and last row of the sample's segment
    low: Indices
    high: Indices
    block: Indices  # shape (n,): unit of the sign flips; blocks do not cross segments
    n_blocks: int
    # shape (n_blocks,): 0 or 1: the half that a block belongs to in held-out tests; the log's own
    # blocks, else runs, segments or stretches, in turn
    fold: Indices
    # shape (n_blocks,): the same, but with long stretches if there are few segments: those that
    # selection leaves out are as long as a free run
    half: Indices
    stretch: Indices  # shape (n,): samples in one are continuous in time

    def __len__(self) -> int:
        return len(self.values)

    def runs(self) -> Iterator[tuple[str, int, slice]]:
        """Yield channel, segment and slice of every stretch that is continuous in time."""
        for name in self.channels:
            edge = self.edges[name]
            segment = self.segment[edge]
            breaks = np.flatnonzero(np.diff(self.stretch[edge])) + 1
            bounds = [0, *breaks.tolist(), len(segment)]
            for a, b in pairwise(bounds):
                if b > a:
                    yield name, int(segment[a]), slice(edge.start + a, edge.start + b)

    @property
    def pieces(self) -> Indices:
        """The stretch of one half that each sample is in, shape (n,); none crosses a segment."""
        unit = self._units[self.block]
        return np.asarray(self.segment * (1 + int(unit.max(initial=0))) + unit)

    @property
    def _units(self) -> Indices:
        """Number of the stretch of one half that each block is in."""
        return np.concatenate([[0], np.cumsum(np.diff(self.half) != 0)])

    def without(self, half: int) -> tuple["Stack", Indices]:
        """Return the blocks outside a half as a stack with its own folds, and its samples here.

        What the half held out between two of its stretches is a gap: no noise continues across it.
        """
        kept = self.half != half
        _, unit = np.unique(self._units[kept], return_inverse=True)
        many = len(unit) and unit[-1] + 1 >= FOLD_RUNS
        fold = (unit if many else np.arange(len(unit))) % 2
        rows = np.flatnonzero(kept[self.block])
        ends = {
            n: np.searchsorted(rows, [e.start, e.stop]) for n, e in self.edges.items()
        }
        number = np.cumsum(kept) - 1
        part = replace(
            self,
            edges={name: slice(int(a), int(b)) for name, (a, b) in ends.items()},
            segment=self.segment[rows],
            t_s=self.t_s[rows],
            values=self.values[rows],
            at=self.at[rows],
            low=self.low[rows],
            high=self.high[rows],
            block=number[self.block[rows]],
            n_blocks=len(fold),
            fold=fold,
            half=fold,
            stretch=self.pieces[rows],
        )
        return part, rows

    def block_sums(self, samples: Array) -> Array:
        """Return the sums over each block, shape (n_blocks,) or (n_blocks, k)."""
        if samples.ndim == 1:
            return np.asarray(np.bincount(self.block, samples, self.n_blocks))
        return np.stack(
            [
                np.bincount(self.block, weights=samples[:, j], minlength=self.n_blocks)
                for j in range(samples.shape[1])
            ],
            axis=1,
        )


def make_stack(
    log: MeasuredLog,
    names: Sequence[str],
    segments: Segments,
    *,
    block_s: float,
    skip_s: float | Array = 0.0,
    usable: Mask | None = None,
) -> Stack:
    """Collect the samples of some channels.

    Parameters
    ----------
    block_s : float
        Length of the sign-flip blocks.
    skip_s : float or ndarray, shape (segments,)
        Time left out at the start of each segment.
    usable : ndarray of bool, shape (segments,), optional
        Segments that take part.
    """
    # of no channel there is no sample
    parts: list[list[NDArray[Any]]] = [
        [np.empty(0, np.int64), *(np.empty(0) for _ in range(3))]
    ]
    edges: dict[str, slice] = {}
    begin, skips_s = 0, np.broadcast_to(skip_s, len(segments))
    for name in names:
        channel = log[name]
        segment, at = segments.locate(channel.span, channel.t_s)
        index = np.maximum(segment, 0)
        keep = (segment >= 0) & (usable is None or usable[index])
        keep &= channel.t_s >= segments.start_s[index] + skips_s[index] - 1e-9
        edges[name] = slice(begin, begin + int(keep.sum()))
        begin = edges[name].stop
        parts.append(
            [array[keep] for array in (segment, channel.t_s, channel.values, at)]
        )
    segment, t_s, values, at = (
        np.concatenate(part) for part in zip(*parts, strict=True)
    )
    segment = segment.astype(np.int64)
    block, n_blocks, fold, half = _blocks(log, segments, segment, t_s, block_s)
    return Stack(
        channels=tuple(names),
        edges=edges,
        segment=segment,
        t_s=t_s,
        values=values,
        at=at,
        low=segments.first[segment],
        high=segments.first[segment + 1] - 1,
        block=block,
        n_blocks=n_blocks,
        fold=fold,
        half=half,
        stretch=segment,
    )


def _blocks(
    log: MeasuredLog, segments: Segments, segment: Indices, t_s: Array, block_s: float
) -> tuple[Indices, int, Indices, Indices]:
    """Return the sign-flip block of each sample, their number, and each block's fold and half."""
    length = segments.end_s - segments.start_s
    own = [s.block for s in log.spans]
    if all(b is not None for b in own) and len(set(own)) > 1:
        labels = np.array([own[s] for s in segments.span], dtype=np.int64)
        names, number = np.unique(labels, return_inverse=True)
        fold = np.arange(len(names)) % 2
        return number[segment], len(names), fold, fold
    per = np.maximum(1, np.rint(length / block_s)).astype(np.int64)
    start = np.concatenate([[0], np.cumsum(per)])
    inside = (
        (t_s - segments.start_s[segment]) / length[segment] * per[segment]
    ).astype(np.int64)
    block = start[segment] + np.clip(inside, 0, per[segment] - 1)
    owner = np.repeat(np.arange(len(segments)), per)
    # Segments of one run share its floor, its beginning and its course. So if there are several
    # runs, whole ones are held out.
    runs, run = np.unique(segments.span, return_inverse=True)
    n = int(start[-1])
    if len(runs) >= FOLD_RUNS:
        fold = half = run[owner] % 2
    elif len(segments) >= FOLD_RUNS:
        fold = half = owner % 2
    else:
        fold, half = np.arange(n) % 2, np.arange(n) * FOLD_RUNS // max(n, 1) % 2
    return block, n, np.asarray(fold), np.asarray(half)
