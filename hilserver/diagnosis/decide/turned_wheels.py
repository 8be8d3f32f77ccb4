"""How wheels turn with the causes of the drive, and what follows for the pose."""

from collections.abc import Mapping

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.decide.identifiability import deviations
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.progress import Report
from hilserver.diagnosis.regression.screen import critical, null_maxima
from hilserver.diagnosis.regression.stages import Prepared, prepare, stages_of
from hilserver.diagnosis.replay.stage import Stage
from hilserver.diagnosis.thresholds import LEAST_GAIN, RIVAL_CLEAR_Z
from hilserver.measured.data import MeasuredLog


def with_wheels(
    p: Prepared, drive: JudgedStage, log: MeasuredLog, jobs: int, report: Report
) -> Prepared | None:
    """Return the pose stage, moved by wheels that turn with the drive's causes.

    Between samples, and where there are none, wheels turn as in the drive's model. None if its
    causes change that too little for any sensor of the pose.
    """
    terms = drive.lasting.terms
    if not terms:
        return None
    anew, shown = _moved(p, terms, log, jobs)
    return prepare(anew, jobs, report)[0] if float(shown @ shown) > LEAST_GAIN else None


def disproved(
    p: Prepared,
    drive: JudgedStage,
    log: MeasuredLog,
    jobs: int,
    rng: np.random.Generator,
) -> frozenset[str]:
    """Return causes of the drive whose turning wheels the pose contradicts.

    A wheel whose encoder shows too much needs the same duty as one whose motor pulls too well.
    If the pose needs no cause with wheels that turn as measured, but misses the data with wheels
    that turn as a cause makes them, that cause is the wrong one.
    """
    named: set[str] = set()
    for f in drive.lasting.fitted:
        _, shown = _moved(p, f.terms, log, jobs)
        worse = p.problem.stack.block_sums(shown * (shown - 2.0 * p.base.left))
        if worse.sum() > LEAST_GAIN and deviations(worse) > RIVAL_CLEAR_Z:
            named.add(f.candidate.cause)
    return frozenset(named) if named and _sound(p, rng) else frozenset()


def _moved(
    p: Prepared, terms: Mapping[str, float], log: MeasuredLog, jobs: int
) -> tuple[Stage, Array]:
    """Return the pose stage with wheels moved by drive terms, and its whitened difference."""
    problem, poses = p.problem, p.base.poses
    anew = stages_of(log, problem.stage.robot, jobs, drive_terms=terms)[
        problem.stage.name
    ]
    moved = problem.stage.difference(
        anew.predict({}, poses), problem.stage.predict({}, poses)
    )
    return anew, problem.shown(p.base, moved)


def _sound(p: Prepared, rng: np.random.Generator) -> bool:
    scores = p.library.scores(p.base)
    largest = float(np.abs(scores.t).max(initial=0.0))
    return not p.base.is_gross and largest < critical(null_maxima([scores], rng))
