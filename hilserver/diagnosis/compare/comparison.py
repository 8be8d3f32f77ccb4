"""Do two sets of logs differ, and how? The unit is the run if there are several.

Every cause is estimated in both sets, at the model that both share. The difference is judged
against the scatter between blocks and, with two or more runs on each side, between runs: the
precision of one run does not tell how far the next run will be off.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilserver.arrays import Mask
from hilserver.diagnosis.checks import Checked
from hilserver.diagnosis.checks.frame import unidentified, without_kinematics
from hilserver.diagnosis.compare.differences import (
    Difference,
    differences_of,
    run_of_spans,
)
from hilserver.diagnosis.compare.differing import (
    difference_findings,
    smallest_differences,
)
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.problem import Point
from hilserver.diagnosis.regression.stages import prepare_all
from hilserver.diagnosis.replay.judgeable import (
    UNSEEN,
    absent,
    of_kinematics,
    vocabulary_reasons,
)
from hilserver.diagnosis.schema.findings import Detectable, Finding
from hilserver.measured.data import Channel, MeasuredLog
from hilserver.plant.parameters import RobotParameters


@dataclass(frozen=True)
class Compared:
    """How two sets of logs differ."""

    logs: tuple[MeasuredLog, ...]  # without their faults
    findings: list[Finding]
    sizes: tuple[Detectable, ...]  # the smallest differences that would have been found
    reasons: dict[str, str]  # why causes are not judged


def compared(
    both: Sequence[Checked],
    robot: RobotParameters,
    seed: int,
    jobs: int,
    tracker: Tracker,
) -> Compared:
    """Estimate every cause in both sets and name what differs."""
    logs = [checked.log for checked in both]
    if why := [
        found for log in logs if (found := unidentified(log, robot)) is not None
    ]:
        logs = [without_kinematics(log, why[0]) for log in logs]
    whole, second = pooled(*logs)
    prepared, reasons = prepare_all(
        whole,
        robot,
        jobs,
        tracker,
        lost_setpoints=any(checked.lost_setpoints for checked in both),
    )
    reasons |= of_kinematics(why[0] if why else None)
    runs, rng = run_of_spans(logs), np.random.default_rng(seed)
    scores = {name: p.library.scores(p.base) for name, p in prepared.items()}
    differences: list[Difference] = []
    points: dict[str, Point] = {}
    for name, p in prepared.items():
        others = [s for n, s in scores.items() if n != name]
        points[name] = select(p.problem, p.library, p.base, rng, jobs, others).point
        differences += differences_of(name, p, points[name], second, runs)
    count = max(len({d.candidate.label for d in differences}), 1)
    differences = [replace(d, p=min(d.p * count, 1.0)) for d in differences]
    judged = {d.candidate.cause for d in differences}
    return Compared(
        tuple(logs),
        difference_findings(differences, prepared, points),
        smallest_differences(differences, count),
        vocabulary_reasons(judged, reasons, set(prepared), absent(whole), UNSEEN),
    )


def pooled(a: MeasuredLog, b: MeasuredLog) -> tuple[MeasuredLog, Mask]:
    """Return both sets as one log, and which of its spans belong to the second."""
    shift = len(a.spans)
    channels = {}
    for name in a.channels.keys() & b.channels.keys():
        x, y = a[name], b[name]
        channels[name] = Channel(
            np.concatenate([x.t_s, y.t_s]),
            np.concatenate([x.values, y.values]),
            np.concatenate([x.span, y.span + shift]),
        )
    later = (replace(s, number=s.number + shift) for s in b.spans)
    spans = tuple(replace(s, block=None) for s in (*a.spans, *later))
    log = replace(a, sources=(*a.sources, *b.sources), channels=channels, spans=spans)
    return log, np.arange(len(spans)) >= shift
