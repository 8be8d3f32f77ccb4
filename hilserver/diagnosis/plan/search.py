"""Combines the pieces with the most information in the available time."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.plan.information import (
    GramDirection,
    directions_of,
    grams_by_span,
    score,
)
from hilserver.diagnosis.plan.null_log import PlannedRecording, Studio
from hilserver.diagnosis.plan.pieces import Piece
from hilserver.diagnosis.progress import Report
from hilserver.diagnosis.regression.stages import prepare, stages_of

MOST_PIECES = 200
TURNS = 4
LEAST_BETTER = 0.01


@dataclass(frozen=True)
class Information:
    """The information of every piece on one stage; shapes (pieces, k, k)."""

    directions: list[GramDirection]
    grams: Array


def information_of(
    found: Sequence[Piece], recording: PlannedRecording, studio: Studio
) -> list[Information]:
    """Measure every piece once, each as a span of its own in one null log."""
    log, _ = studio.null_log([piece.manoeuvre for piece in found], recording)
    known = []
    for stage in stages_of(log, studio.robot).values():
        prepared, _ = prepare(stage, studio.jobs, studio.report)
        if prepared is not None:
            library = prepared.library
            known.append(
                Information(directions_of(library), grams_by_span(library, len(found)))
            )
    return known


def choose(
    found: Sequence[Piece],
    known: Sequence[Information],
    duration_s: float,
    report: Report,
) -> list[Piece]:
    """Return the pieces with the most information; repetitions are allowed.

    As long as one fits, the piece with the most information per second is added; then each is
    exchanged for a better one until there is none.
    """
    search = _Search([p.manoeuvre.duration_s for p in found], known, duration_s)
    search.add()
    for turn in range(TURNS):
        report("choosing pieces", turn / TURNS)
        if not search.exchange():
            break
        search.add()
    return [found[i] for i in search.chosen]


class _Search:
    """The pieces chosen so far and their joint information."""

    def __init__(
        self, lengths_s: Sequence[float], known: Sequence[Information], left_s: float
    ) -> None:
        self.chosen: list[int] = []
        self._lengths_s = np.array(lengths_s)
        self._known = known
        self._sums = [np.zeros(t.grams.shape[1:]) for t in known]
        self._left_s = left_s
        self._now = 0.0

    def _able(self, room_s: float) -> list[int]:
        return np.flatnonzero(self._lengths_s <= room_s + 1e-9).tolist()

    def _with(self, more: int, less: int | None = None) -> float:
        total = 0.0
        for t, present in zip(self._known, self._sums, strict=True):
            changed = present + t.grams[more] - (0.0 if less is None else t.grams[less])
            total += score(t.directions, changed)
        return total

    def add(self) -> None:
        """Add pieces as long as one fits."""
        while len(self.chosen) < MOST_PIECES and (able := self._able(self._left_s)):
            totals = np.array([self._with(i) for i in able])
            rates = (totals - self._now) / self._lengths_s[able]
            self._put(able[int(np.argmax(rates))])

    def exchange(self) -> bool:
        """Exchange every piece for the best in its place; return whether one was better."""
        better = False
        for place in range(len(self.chosen)):
            mine = self.chosen[place]
            able = self._able(self._left_s + float(self._lengths_s[mine]))
            totals = [self._with(i, mine) if i != mine else self._now for i in able]
            best = int(np.argmax(totals))
            if totals[best] > self._now + LEAST_BETTER:
                self._take(place)
                self._put(able[best], place)
                better = True
        return better

    def _put(self, piece: int, place: int | None = None) -> None:
        self.chosen.insert(len(self.chosen) if place is None else place, piece)
        self._change(piece, 1.0)

    def _take(self, place: int) -> None:
        self._change(self.chosen.pop(place), -1.0)

    def _change(self, piece: int, sign: float) -> None:
        self._left_s -= sign * float(self._lengths_s[piece])
        self._sums = [
            total + sign * t.grams[piece]
            for t, total in zip(self._known, self._sums, strict=True)
        ]
        self._now = sum(
            score(t.directions, s) for t, s in zip(self._known, self._sums, strict=True)
        )
