"""Puts the pieces together that tell most in the time there is."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from hilserver.diagnosis.plan.information import (
    Array,
    Direction,
    directions_of,
    grams_by_span,
    score,
)
from hilserver.diagnosis.plan.null_log import Recording, null_log
from hilserver.diagnosis.plan.outlook import Tell
from hilserver.diagnosis.plan.pieces import Piece
from hilserver.diagnosis.stages import prepare, stages_of
from hilserver.plant.parameters import RobotParameters

MOST_PIECES = 200
SETTLED = 1e-3
"""Score per second below which another piece is only a repetition."""


@dataclass(frozen=True)
class Told:
    """What every piece tells to one stage; shapes (pieces, k, k)."""

    directions: list[Direction]
    grams: Array


def told_by(
    found: Sequence[Piece],
    robot: RobotParameters,
    recording: Recording,
    *,
    seed: int,
    jobs: int,
    tell: Tell,
) -> list[Told]:
    """Measure every piece once, each as a span of its own in one null log."""
    rng = np.random.default_rng(seed)
    log = null_log([piece.manoeuvre for piece in found], robot, recording, rng)
    told = []
    for stage in stages_of(log, robot).values():
        prepared, _ = prepare(stage, jobs, tell)
        if prepared is not None:
            library = prepared.library
            told.append(Told(directions_of(library), grams_by_span(library, len(found))))
    return told


def choose(found: Sequence[Piece], told: Sequence[Told], duration_s: float) -> list[Piece]:
    """Add pieces where a second tells most, as long as one fits; repetitions are allowed."""
    chosen: list[int] = []
    sums = [np.zeros(t.grams.shape[1:]) for t in told]
    now, left_s = 0.0, duration_s
    while len(chosen) < MOST_PIECES:
        able = [i for i, p in enumerate(found) if p.manoeuvre.duration_s <= left_s + 1e-9]
        if not able:
            break
        totals = np.array([_total(told, sums, i) for i in able])
        seconds = np.array([found[i].manoeuvre.duration_s for i in able])
        rates = (totals - now) / seconds
        best = int(np.argmax(rates))
        if rates[best] <= SETTLED:
            # what is there is known well: the rest of the time goes to what was driven least
            counts = np.array([chosen.count(i) for i in able])
            best = int(np.lexsort((-rates, counts))[0])
        chosen.append(able[best])
        now, left_s = float(totals[best]), left_s - float(seconds[best])
        for total, t in zip(sums, told, strict=True):
            total += t.grams[able[best]]
    return [found[i] for i in chosen]


def _total(told: Sequence[Told], sums: Sequence[Array], more: int) -> float:
    return sum(
        score(t.directions, total + t.grams[more]) for t, total in zip(told, sums, strict=True)
    )
