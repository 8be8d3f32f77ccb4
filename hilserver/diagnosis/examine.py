"""One member of a diagnosis, a set of logs that count as one: faults, stages, decisions."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hilserver.diagnosis.checks.frame import unidentified, without_kinematics
from hilserver.diagnosis.decide import limited_duty, one_topic
from hilserver.diagnosis.decide.beginning import Terms
from hilserver.diagnosis.decide.revision import JudgedStage, revised
from hilserver.diagnosis.decide.selection import select
from hilserver.diagnosis.decide.turned_wheels import disproved, with_wheels
from hilserver.diagnosis.findings.detectable import smallest_of
from hilserver.diagnosis.findings.sensors import noise_of
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.screen import Scores
from hilserver.diagnosis.regression.stages import Prepared, prepare, prepare_all
from hilserver.diagnosis.replay.judgeable import of_kinematics
from hilserver.diagnosis.schema.decisions import Decision
from hilserver.diagnosis.schema.findings import Detectable, Finding, Noise, NotJudged
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.plant.parameters import RobotParameters


@dataclass(frozen=True)
class Member:
    """Logs that count as one, and what was decided about each of their stages."""

    name: str  # of a group of logs; empty without groups
    log: MeasuredLog  # without its faults
    robot: RobotParameters
    faults: tuple[Finding, ...]
    judged: dict[str, JudgedStage]  # by stage
    reasons: dict[str, str]  # why causes are not judged

    @property
    def noise(self) -> dict[str, Noise]:
        """Noise, resolution and limits of every channel of all stages."""
        return {
            n: o
            for j in self.judged.values()
            for n, o in noise_of(j.prepared.problem).items()
        }

    @property
    def decisions(self) -> list[Decision]:
        """The steps of the selection of all stages."""
        rows = (row for j in self.judged.values() for row in j.selected.rows)
        return [replace(row, group=self.name or None) for row in rows]

    def smallest(
        self, rng: np.random.Generator
    ) -> tuple[list[Detectable], list[NotJudged]]:
        """Return the smallest effects that would have shown, and what the drive did not excite."""
        return smallest_of(
            [(j.prepared.library, j.point) for j in self.judged.values()], rng
        )


def examine(
    log: MeasuredLog,
    robot: RobotParameters,
    rng: np.random.Generator,
    jobs: int,
    tracker: Tracker,
    name: str = "",
    running: Terms = MappingProxyType({}),
) -> Member:
    """Check logs, select causes, swap, prune; map the remainder; drop what that puts in doubt."""
    robot = machine(log, robot)
    tracker("checking the data", 0.0)
    checked = one_topic.checked(log, robot)
    why = unidentified(checked.log, robot)
    log = checked.log if why is None else without_kinematics(checked.log, why)
    log, limits = limited_duty.find(log, robot)
    tracker.timed("checks")
    prepared, reasons = prepare_all(
        log, robot, jobs, tracker, lost_setpoints=checked.lost_setpoints
    )
    tracker.timed("effects")
    tracker("selecting causes", 0.0)
    scores = {name: p.library.scores(p.base) for name, p in prepared.items()}
    judged: dict[str, JudgedStage] = {}

    def judge(p: Prepared, others: Sequence[Scores]) -> JudgedStage:
        selected = select(p.problem, p.library, p.base, rng, jobs, others, running)
        tracker.timed("selection")
        found = revised(p, selected, rng)
        tracker.timed("revision")
        return found

    for stage, as_configured in prepared.items():
        anew = None
        if (drive := judged.get("drive")) is not None:
            barred = disproved(as_configured, drive, log, jobs, rng)
            other = (
                prepare(drive.prepared.problem.stage, jobs, tracker, barred)[0]
                if barred
                else None
            )
            if other is not None:
                drive = judged["drive"] = judge(other, [scores[stage]])
            anew = with_wheels(as_configured, drive, log, jobs, tracker)
        others = [] if anew else [s for n, s in scores.items() if n != stage]
        judged[stage] = judge(anew or as_configured, others)
    return Member(
        name,
        log,
        robot,
        (*checked.findings, *limits),
        judged,
        reasons | of_kinematics(why),
    )
