"""One set of logs: its faults, its stages, and what was decided of each of them."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilserver.diagnosis.checks import Checked, check
from hilserver.diagnosis.checks.frame import untold, without_kinematics
from hilserver.diagnosis.decide import limited_duty
from hilserver.diagnosis.decide.lost_steps import lost_steps
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.decide.settling import Judged, settled
from hilserver.diagnosis.decide.turned_wheels import disproved, with_wheels
from hilserver.diagnosis.findings.detectable import smallest
from hilserver.diagnosis.findings.outcome import (
    coarse,
    deviating,
    lost,
    misplaced_anchor,
    outliers,
    structure,
)
from hilserver.diagnosis.findings.sensors import noise_of
from hilserver.diagnosis.regression.screen import Scores, critical, null_maxima
from hilserver.diagnosis.regression.stages import (
    Prepared,
    prepare,
    prepare_all,
)
from hilserver.diagnosis.schema.findings import Decision, Detectable, Finding, Noise, NotJudged
from hilserver.diagnosis.thresholds import FEWEST_EVENTS, NEGLIGIBLE
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.plant.parameters import RobotParameters

Tell = Callable[[str, float], None]


@dataclass(frozen=True)
class Examined:
    """A log with its faults taken out, and what was decided of each of its stages."""

    checked: Checked
    log: MeasuredLog
    robot: RobotParameters
    judged: dict[str, Judged]
    reasons: dict[str, str]


def examine(
    log: MeasuredLog,
    robot: RobotParameters,
    rng: np.random.Generator,
    jobs: int,
    tell: Tell,
    lap: Callable[[str], None],
) -> Examined:
    """Check a log, select causes, swap, prune; map what remains; drop what that puts in doubt."""
    robot = machine(log, robot)
    tell("checking the data", 0.0)
    checked = check(log, robot)
    why = untold(checked.log, robot)
    log = checked.log if why is None else without_kinematics(checked.log, why)
    log, limits = limited_duty.find(log, robot)
    checked = replace(checked, findings=(*checked.findings, *limits))
    lap("checks")
    prepared, reasons = prepare_all(log, robot, jobs, tell, lost_setpoints=checked.lost_setpoints)
    lap("effects")
    tell("selecting causes", 0.0)
    scores = {name: p.library.scores(p.base) for name, p in prepared.items()}
    judged: dict[str, Judged] = {}

    def judge(p: Prepared, beside: Sequence[Scores]) -> Judged:
        selected = select(p.problem, p.library, p.base, rng, jobs, beside)
        lap("selection")
        found = settled(p, selected, rng)
        lap("settling")
        return found

    for name, as_configured in prepared.items():
        anew = None
        if (drive := judged.get("drive")) is not None:
            barred = disproved(as_configured, drive, log, jobs, rng)
            other = prepare(drive.prepared.problem.stage, jobs, tell, barred)[0] if barred else None
            if other is not None:
                drive = judged["drive"] = judge(other, [scores[name]])
            anew = with_wheels(as_configured, drive, log, jobs, tell)
        beside = [] if anew else [s for n, s in scores.items() if n != name]
        judged[name] = judge(anew or as_configured, beside)
    return Examined(checked, log, robot, judged, reasons)


def beside(j: Judged) -> list[Finding]:
    """Return what was found in one stage beside fitted causes."""
    problem, found = j.prepared.problem, []
    if j.prepared.coarse_rpm is not None:
        found.append(coarse(j.prepared.coarse_rpm))
    if (strays := outliers(problem, j.point)) is not None:
        found.append(strays)
    if j.anchor is not None:
        found.append(misplaced_anchor(*j.anchor))
    steps = lost_steps(problem, j.point)
    if steps is not None and steps.share > NEGLIGIBLE and steps.events >= FEWEST_EVENTS:
        found.append(lost(steps))
    elif j.unknown:
        found.append(structure(j.unknown, problem.stage.block, deviating(problem, j.point)))
    return found


def noise_of_all(judged: Mapping[str, Judged]) -> dict[str, Noise]:
    """Return noise, resolution and limits of every channel of all stages."""
    found: dict[str, Noise] = {}
    for j in judged.values():
        found |= noise_of(j.prepared.problem)
    return found


def smallest_of(
    judged: Mapping[str, Judged], rng: np.random.Generator
) -> tuple[list[Detectable], list[NotJudged]]:
    """Return the smallest effects that would have shown, and what the drive did not excite."""
    scores = {n: j.prepared.library.scores(j.point) for n, j in judged.items()}
    limit = critical(null_maxima(list(scores.values()), rng)) if scores else 0.0
    sizes: list[Detectable] = []
    silent: list[NotJudged] = []
    for name, j in judged.items():
        more, not_judged = smallest(j.prepared.library, scores[name], limit)
        sizes += more
        silent += not_judged
    return sizes, silent


def decisions_of(judged: Mapping[str, Judged], group: str | None = None) -> Iterator[Decision]:
    """Yield the steps of the selection of all stages."""
    for row in (row for j in judged.values() for row in j.selected.rows):
        yield Decision(
            cause=row.cause,
            action=row.action,
            held_out_gain=row.held_out_gain,
            reason=row.reason,
            group=group,
        )
