"""How wheels turn: by the causes of the drive, and what follows for the pose."""

from collections.abc import Mapping

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.decide.identifiability import deviations
from hilserver.diagnosis.decide.revision import Judged
from hilserver.diagnosis.progress import Report
from hilserver.diagnosis.regression.screen import critical, null_maxima
from hilserver.diagnosis.regression.stages import Prepared, prepare, stages_of
from hilserver.diagnosis.replay.stage import Stage
from hilserver.diagnosis.thresholds import LEAST_GAIN, RIVAL_CLEAR_Z
from hilserver.measured.data import MeasuredLog


def with_wheels(
    p: Prepared, drive: Judged, log: MeasuredLog, jobs: int, report: Report
) -> Prepared | None:
    """Return the pose, moved by the wheels as they turn with the drive's causes.

    Between their samples, and where they have none, they turn as in the drive's model. None where
    what its causes change of that is too little for any sensor of the pose to show.
    """
    terms = drive.lasting.terms
    if not terms:
        return None
    anew, shown = _moved(p, terms, log, jobs)
    return prepare(anew, jobs, report)[0] if float(shown @ shown) > LEAST_GAIN else None


def disproved(
    p: Prepared, drive: Judged, log: MeasuredLog, jobs: int, rng: np.random.Generator
) -> frozenset[str]:
    """Return causes of the drive that make wheels turn as the pose shows that they do not.

    A wheel whose encoder shows too much and one whose motor pulls too well take the same duty.
    Where the pose needs no cause with wheels that turn as measured, and misses the data with wheels
    that turn as with a cause, that cause is the wrong one.
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
    """Return the pose whose wheels turn by terms of the drive, and its whitened difference."""
    problem, poses = p.problem, p.base.poses
    anew = stages_of(log, problem.stage.robot, jobs, drive_terms=terms)[problem.stage.name]
    moved = problem.stage.difference(anew.predict({}, poses), problem.stage.predict({}, poses))
    return anew, problem.shown(p.base, moved)


def _sound(p: Prepared, rng: np.random.Generator) -> bool:
    scores = p.library.scores(p.base)
    largest = float(np.abs(scores.t).max(initial=0.0))
    return not p.base.is_gross and largest < critical(null_maxima([scores], rng))
