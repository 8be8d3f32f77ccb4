"""Builds the regressions of a log: its stages, their noise, and all columns."""

from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from hilserver.arrays import Array, Columns
from hilserver.diagnosis.catalogue.traits import Need
from hilserver.diagnosis.catalogue.vocabulary import SPEED_STEP
from hilserver.diagnosis.checks.comb import coarse_step
from hilserver.diagnosis.progress import Report
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.encoders import as_turned, driven
from hilserver.diagnosis.replay.judgeable import (
    HOLDS,
    LOST_SETPOINTS,
    absent,
    judged_candidates,
    splits,
)
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.replay.stage import Stage
from hilserver.diagnosis.thresholds import BLOCK_S, HALF, SAME
from hilserver.measured.channels import DUTIES, SPEEDS
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

SHOWN: Final = {Need.POSITION: "position", Need.YAW: "heading", Need.GYRO: "turn rate"}
"""What shows the motion of a robot."""


@dataclass
class Prepared:
    """One stage, ready to be judged."""

    problem: Problem
    library: Library
    base: Point
    # step in which the wheel speeds come, large enough to keep the loop from coming to rest
    coarse_rpm: float | None = None


def block_length(
    total_s: float, shortest_s: float, longest_s: float, aim: int
) -> float:
    """Return the length of sign-flip blocks that gives about `aim` of them."""
    return float(np.clip(total_s / aim, shortest_s, longest_s))


def stages_of(
    log: MeasuredLog,
    robot: RobotParameters,
    jobs: int = 1,
    drive_terms: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, Stage]:
    """Return the stages that a log has the channels for; each may run in `jobs` threads.

    Parameters
    ----------
    drive_terms : mapping of str to float
        What is known of the drive, for the wheel speeds that move the pose.
    """
    total_s = sum(s.end_s - s.start_s for s in log.spans)
    stages: dict[str, Stage] = {}
    drive = None
    if DriveStage.judges(log) and log.drive_is_known:
        drive = DriveStage(log, robot, block_s=block_length(total_s, BLOCK_S, 5.0, 72))
        stages[drive.name] = drive
    elif log.drive_is_known and DriveStage.replays(log):
        drive = DriveStage(log, robot, block_s=BLOCK_S)
    if PoseStage.judges(log, robot, driven=drive is not None):
        known = None if drive is None else driven(drive, drive_terms)
        turned, block_s = (
            as_turned(log, robot, drive_terms),
            block_length(total_s, 3.0, 5.0, 72),
        )
        stages[PoseStage.name] = PoseStage(
            turned, robot, known, block_s=block_s, jobs=jobs
        )
    return stages


def foretold(log: MeasuredLog, robot: RobotParameters) -> str:
    """Return in one line what can be judged with the channels of a log, and what cannot."""
    missing = absent(log)
    known = log.drive_is_known
    can: list[str] = []
    cannot: list[str] = []

    if known and DriveStage.judges(log):
        can.append("the drive")
    else:
        cannot.append(f"the drive ({missing['drive']})")

    if PoseStage.judges(log, robot, driven=known and DriveStage.replays(log)):
        there: list[str] = []
        for need, words in SHOWN.items():
            if HOLDS[need](log):
                there.append(words)
            else:
                cannot.append(f"its {words} ({need})")
        can.append(f"the motion by {', '.join(there)}")
    elif log.marks:
        can.append(f"the robot's dimensions by {len(log.marks)} marks")
    else:
        cannot.append(f"the motion ({missing['pose']})")

    yes = (
        f"This log shows {' and '.join(can)}"
        if can
        else "This log shows nothing to judge"
    )
    return f"{yes}; not judged: {', '.join(cannot)}." if cannot else f"{yes}."


def prepare_all(
    log: MeasuredLog,
    robot: RobotParameters,
    jobs: int,
    report: Report,
    *,
    lost_setpoints: bool = False,
) -> tuple[dict[str, Prepared], dict[str, str]]:
    """Return the stages of a log, ready to be judged, and why some causes are not judged.

    Parameters
    ----------
    lost_setpoints : bool
        The recording does not hold the set-points that the machine received.
    """
    prepared: dict[str, Prepared] = {}
    reasons: dict[str, str] = {}
    for name, stage in stages_of(log, robot, jobs).items():
        if stage.follows_setpoints and lost_setpoints:
            candidates, others = judged_candidates(stage)
            reasons |= dict.fromkeys(
                [*others, *(c.cause for c in candidates)], LOST_SETPOINTS
            )
            continue
        one, why = prepare(stage, jobs, report)
        reasons |= why
        if one is not None:
            prepared[name] = one
    return prepared, reasons


def prepare(
    stage: Stage, jobs: int, report: Report, barred: frozenset[str] = frozenset()
) -> tuple[Prepared | None, dict[str, str]]:
    """Estimate a stage's noise and compute the columns of all causes that are not barred."""
    if len(stage.stack) == 0:
        return None, {}
    candidates, reasons = judged_candidates(stage)
    candidates = [
        c for c in candidates if splits(stage.log, c) and c.cause not in barred
    ]
    problem = Problem(stage)
    base = _as_configured(problem)
    coarse_rpm = _coarse(problem, base)
    if coarse_rpm is not None:
        candidates = [c for c in candidates if c.cause != SPEED_STEP]
        problem.ripples = True
        problem.estimate_noise(problem.residual(base.predicted))
        base = problem.point(Model(), base.poses)
    raw: list[Columns] = []
    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        for i, column in enumerate(
            pool.map(lambda c: problem.column(base, c), candidates)
        ):
            raw.append(column.astype(np.float32))
            report(
                f"{stage.name}: effect of {candidates[i].label}",
                (i + 1) / len(candidates),
            )
    return _ready(problem, Library(problem, candidates, raw), base, coarse_rpm), reasons


def without(p: Prepared, half: int) -> Prepared | None:
    """Return a stage that has never seen one half of its blocks; None if nothing is left.

    Only the plant's part of the columns is kept: noise, and all that depends on it, is estimated
    again.
    """
    p.problem.forget()
    stack, rows = p.problem.stack.without(half)
    if not len(stack) or len(rows) == len(p.problem.stack):
        return None
    problem = Problem(p.problem.stage.on(stack), ripples=p.problem.ripples)
    library = Library(
        problem, p.library.candidates, [raw[rows] for raw in p.library.raw]
    )
    return _ready(problem, library, _as_configured(problem), p.coarse_rpm)


def _as_configured(problem: Problem) -> Point:
    """Estimate a first noise; return the model without any cause."""
    poses = problem.start_poses({})
    problem.estimate_noise(problem.residual(problem.predict({}, poses)))
    base = problem.point(Model(), poses, pose_steps=2)
    problem.estimate_noise(problem.residual(base.predicted))
    return problem.point(Model(), base.poses)


def _ready(
    problem: Problem, library: Library, base: Point, coarse_rpm: float | None
) -> Prepared:
    clean(problem, library, base)
    base = problem.point(Model(), base.poses)
    library.rewhiten(base)
    return Prepared(problem, library, base, coarse_rpm)


def _coarse(problem: Problem, base: Point) -> float | None:
    """Return the step of coarse wheel speeds if the replay of smooth ones misses grossly.

    A loop on a coarse speed hunts about its set-point, and no replay stays in step with it for
    long: the measured values themselves show the step, and the ripple counts as noise.
    """
    names = [
        n
        for n in SPEEDS
        if n in problem.stack.edges and n not in problem.stage.log.made
    ]
    if not names or not base.is_gross:
        return None
    parts = [problem.stack.edges[n] for n in names]
    values = problem.stack.values
    step = coarse_step([values[e] for e in parts], [base.predicted[e] for e in parts])
    rounded = [
        problem.readings[n].step for n in names if problem.readings[n].step > 0.0
    ]
    if step is None or not rounded:
        return step
    own = all(abs(step - one) < SAME * one for one in rounded)
    return step if own and _answered(problem, base, step) else None


def _answered(problem: Problem, base: Point, step_rpm: float) -> bool:
    """Return whether the duties respond to every step of the speeds, as in a loop on coarse ones.

    If readings are only rounded, the steps exist in the log alone.
    """
    stack = problem.stack
    edges = [stack.edges[n] for n in DUTIES if n in stack.edges]
    coarse = problem.predict({SPEED_STEP: step_rpm}, base.poses)

    def ripple(duty: Array) -> float:
        return float(np.mean(np.concatenate([np.abs(np.diff(duty[e])) for e in edges])))

    if not edges:
        return False
    smooth, stepped = ripple(base.predicted), ripple(coarse)
    return ripple(stack.values) - smooth > HALF * (stepped - smooth)


def clean(problem: Problem, library: Library, point: Point) -> None:
    """Estimate the noise from what no cause at all can explain, so that no effect hides in it.

    With few short segments, a hundred columns would explain the noise as well: there what they
    explain is taken from the other half.
    """
    library.rewhiten(point)
    if problem.is_short:
        raw = of_the_other_half(problem, library, point)
    else:
        raw = library.effect(library.ridge(point), slice(None))
    left = problem.residual(point.predicted) - raw
    nuisance = problem.nuisance(point.predicted, point.poses)
    bases = problem.bases(nuisance)
    if nuisance is not None and bases is not None:
        step = bases.step(problem.whiten(left))
        left = left - (nuisance * step[problem.stack.segment]).sum(axis=1)
    problem.estimate_noise(left)


def of_the_other_half(problem: Problem, library: Library, point: Point) -> Array:
    """Return what all causes explain of each fold, with coefficients from the other fold."""
    fold = problem.stack.fold[problem.stack.block]
    out = np.zeros(len(fold))
    for test in (0, 1):
        train, rows = fold != test, np.flatnonzero(fold == test)
        if train.any() and len(rows):
            weight = library.ridge(point, train[library.blocks.order])
            out[rows] = library.effect(weight, rows)
    return out
