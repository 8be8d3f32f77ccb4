"""Both recordings as curves for a plot: what is drawn is what was compared."""

import json
import math
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.comparison.comparing import RecordingComparison, sizes
from hilserver.comparison.rows import Shared
from hilserver.comparison.text import as_text
from hilserver.measured.names import known_signals

_MOST_PLACES: Final = 1024
"""Stretches of time with a value each; a screen has no more columns for them."""
_MOST_DRAWN: Final = 24
"""Signals that are drawn: those that part first."""


class Curves:
    """What was smallest and largest in equal stretches of time, however long the recordings are.

    The stretches double in length whenever there would be too many.
    """

    def __init__(self) -> None:
        self._bits = 0
        self._begin_ns: int | None = None
        self._end_ns = 0
        self._shift_ns: dict[int, int] = {}
        self._kept: dict[str, NDArray[np.float64]] = {}

    def add(self, piece: Shared, names: list[str]) -> None:
        """Take in the rows of one segment; later ones stand behind the first, on its clock."""
        if self._begin_ns is None:
            self._begin_ns = self._end_ns = int(piece.t_ns[0])
        behind_ns = self._end_ns - int(piece.t_ns[0])
        shift_ns = self._shift_ns.setdefault(piece.segment, behind_ns)
        since_ns = piece.t_ns + (shift_ns - self._begin_ns)
        self._end_ns = int(piece.t_ns[-1]) + shift_ns
        while since_ns[-1] >> self._bits >= _MOST_PLACES:
            self._double()

        place = since_ns >> self._bits
        begins = np.flatnonzero(np.diff(place, prepend=-1))
        at = place[begins]
        for name in names:
            a = piece.a.columns[name][piece.rows_of_a]
            b = piece.b.columns[name][piece.rows_of_b]
            kept = self._kept.setdefault(name, np.full((5, _MOST_PLACES), np.nan))
            series = (a, a, b, b, sizes(name, a, b))
            for row, extreme, values in zip(kept, _EXTREMES, series, strict=True):
                row[at] = extreme(row[at], extreme.reduceat(values, begins))

    def _double(self) -> None:
        self._bits += 1
        half = _MOST_PLACES // 2
        for kept in self._kept.values():
            for row, extreme in zip(kept, _EXTREMES, strict=True):
                row[:half] = extreme.reduce(row.reshape(half, 2), axis=1)
            kept[:, half:] = np.nan

    def as_json(self, found: RecordingComparison) -> bytes:
        """Return the comparison as the page draws it.

        Returns
        -------
        bytes
            JSON with `text`, `t_s` and `signals`: for each that differs, in the order in which
            they part, `name`, `unit`, when it parts on the axis of `t_s` [s], and the series
            `a`, `b`, `difference`; null where there is no value. Where several rows share a
            place, the smallest and the largest stand there one after the other.
        """
        drawn = found.partings[:_MOST_DRAWN]
        kept = np.array([self._kept[p.signal] for p in drawn]).reshape(
            -1, 5, _MOST_PLACES
        )
        used = np.flatnonzero(~np.isnan(kept).all(axis=(0, 1)))
        kept = kept[:, :, used]
        low, high = kept[:, 0:4:2], kept[:, 1:4:2]
        width = 2 if (low < high).any() else 1
        both = np.stack([low, high][:width], axis=-1).reshape(
            len(drawn), 2, len(used) * width
        )
        difference = np.repeat(kept[:, 4], width, axis=-1)

        steps = np.arange(width) / width
        begin_s = (self._begin_ns or 0) * 1e-9
        t_s = (begin_s + (used[:, None] + steps) * (1e-9 * 2**self._bits)).ravel()
        signals = [
            {
                "name": parting.signal,
                "unit": _unit(parting.signal),
                "parts_at_s": self._axis_s(parting.segment, parting.t_ns),
                "a": _numbers(a),
                "b": _numbers(b),
                "difference": _numbers(size),
            }
            for parting, (a, b), size in zip(drawn, both, difference, strict=True)
        ]
        content: dict[str, Any] = {"text": as_text(found), "t_s": _numbers(t_s)}
        return json.dumps(content | {"signals": signals}, allow_nan=False).encode()

    def _axis_s(self, segment: int, t_ns: int) -> float:
        return (t_ns + self._shift_ns[segment]) * 1e-9


_EXTREMES: Final = (np.fmin, np.fmax, np.fmin, np.fmax, np.fmax)
"""What a row of `_kept` holds: of A smallest and largest, of B, and the largest difference."""


def _numbers(values: NDArray[np.float64]) -> list[float | None]:
    return [float(f"{v:.9g}") if math.isfinite(v) else None for v in values.tolist()]


def _unit(name: str) -> str:
    signal = known_signals().get(name)
    return signal.unit if signal is not None else ""
