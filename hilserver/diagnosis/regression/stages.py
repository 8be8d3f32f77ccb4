"""Makes the regressions of a log: which stages it has, their noise, and all columns."""

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.catalogue.vocabulary import SPEED_SCALES
from hilserver.diagnosis.checks.comb import coarse_step
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.judgeable import judged_candidates, splits
from hilserver.diagnosis.replay.model import Model, robot_with
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.thresholds import GROSS, READING_SAME_STEP, RIPPLE_ANSWERED
from hilserver.measured.channels import DUTIES, SPEEDS
from hilserver.measured.data import MeasuredLog
from hilserver.plant.layout import P_ENCODER_GAIN
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]


@dataclass
class Prepared:
    """One stage, ready to be judged.

    Attributes
    ----------
    coarse_rpm : float or None
        Step that the wheel speeds come in, large enough to keep the loop from coming to rest.
    """

    problem: Problem
    library: Library
    base: Point
    coarse_rpm: float | None = None


def machine(log: MeasuredLog, robot: RobotParameters) -> RobotParameters:
    """Return the plant of the log: the configured one with the keys of the mapping file.

    A two-wheel robot (``track_m`` without ``wheelbase_m``) turns at 1/track about its axle.
    """
    keys = dict(log.plant)
    if "track_m" in keys and "wheelbase_m" not in keys:
        keys.setdefault("icr_offset_m", 0.0)
        keys["wheelbase_m"] = None
        keys.setdefault("rotation_gain", "geometric_diff")
    known = {k: v for k, v in keys.items() if hasattr(robot, k)}
    return replace(robot, **known)  # type: ignore[arg-type]


def block_length(total_s: float, shortest_s: float, longest_s: float, aim: int) -> float:
    """Return the length of sign-flip blocks that gives about `aim` of them."""
    return float(np.clip(total_s / aim, shortest_s, longest_s))


def stages_of(
    log: MeasuredLog,
    robot: RobotParameters,
    jobs: int = 1,
    drive_terms: Mapping[str, float] = MappingProxyType({}),
) -> dict[str, DriveStage | PoseStage]:
    """Return the stages that a log has the channels for; their runs may use so many threads.

    Parameters
    ----------
    drive_terms : mapping of str to float
        What is known of the drive, for the wheel speeds that move the pose.
    """
    total_s = sum(s.end_s - s.start_s for s in log.spans)
    stages: dict[str, DriveStage | PoseStage] = {}
    if DriveStage.judges(log) and log.drive_is_known:
        stages["drive"] = DriveStage(log, robot, block_s=block_length(total_s, 1.0, 5.0, 72))
    if PoseStage.judges(log, robot, driven="drive" in stages):
        stages["pose"] = pose_stage(log, robot, stages.get("drive"), drive_terms, jobs)
    return stages


def pose_stage(
    log: MeasuredLog,
    robot: RobotParameters,
    drive: DriveStage | PoseStage | None,
    terms: Mapping[str, float],
    jobs: int = 1,
) -> PoseStage:
    """Return the pose stage, its wheel speeds interpolated by the drive with these terms."""
    log = as_turned(log, robot, terms)
    total_s = sum(s.end_s - s.start_s for s in log.spans)
    dense = None
    if isinstance(drive, DriveStage):
        dense = (drive, drive.simulate(terms)[0])
    block_s = block_length(total_s, 3.0, 5.0, 72)
    return PoseStage(log, robot, dense, block_s=block_s, jobs=jobs)


def speed_factors(robot: RobotParameters, terms: Mapping[str, float]) -> dict[str, float]:
    """Return by how much each wheel's speed in the log is that of the wheel, where it is not 1."""
    gains = pack(robot_with(robot, {k: v for k, v in terms.items() if k.startswith("encoder")}))
    factors = {
        name: terms.get(scale, 1.0) * float(gains[P_ENCODER_GAIN + wheel])
        for wheel, (name, scale) in enumerate(SPEED_SCALES.items())
    }
    return {name: factor for name, factor in factors.items() if factor != 1.0}


def as_turned(log: MeasuredLog, robot: RobotParameters, terms: Mapping[str, float]) -> MeasuredLog:
    """Return the log with the speeds at which the wheels turned, whatever their encoders show."""
    factors = speed_factors(robot, terms)
    return log.with_channels({
        name: log[name].with_values(log[name].values / factor)
        for name, factor in factors.items() if name in log
    })  # fmt: skip


def prepare_all(
    log: MeasuredLog,
    robot: RobotParameters,
    jobs: int,
    tell: Tell,
    *,
    lost_setpoints: bool = False,
) -> tuple[dict[str, Prepared], dict[str, str]]:
    """Return the stages of a log, ready to be judged, and why some causes are not judged.

    Parameters
    ----------
    lost_setpoints : bool
        The recording does not hold the set-points that the machine got.
    """
    prepared: dict[str, Prepared] = {}
    reasons: dict[str, str] = {}
    for name, stage in stages_of(log, robot, jobs).items():
        if name == "drive" and lost_setpoints:
            text = "the log does not hold the set-points that the machine got"
            candidates, others = judged_candidates(stage)
            reasons |= dict.fromkeys([*others, *(c.cause for c in candidates)], text)
            continue
        one, why = prepare(stage, jobs, tell)
        reasons |= why
        if one is not None:
            prepared[name] = one
    return prepared, reasons


def prepare(
    stage: DriveStage | PoseStage, jobs: int, tell: Tell
) -> tuple[Prepared | None, dict[str, str]]:
    """Learn a stage's noise and compute all its columns."""
    if len(stage.stack) == 0:
        return None, {}
    candidates, reasons = judged_candidates(stage)
    candidates = [c for c in candidates if splits(stage.log, c)]
    problem = Problem(stage)
    poses = problem.start_poses({})
    problem.learn_noise(problem.residual(problem.predict({}, poses)))
    base = problem.point(Model(), poses, pose_steps=2)
    problem.learn_noise(problem.residual(base.predicted))
    base = problem.point(Model(), base.poses)
    coarse_rpm = _coarse(problem, base)
    if coarse_rpm is not None:
        candidates = [c for c in candidates if c.cause != "encoder_quantization"]
        problem.ripples = True
        problem.learn_noise(problem.residual(base.predicted))
        base = problem.point(Model(), base.poses)
    raw: list[NDArray[np.float32]] = []
    with ThreadPoolExecutor(max(jobs, 1)) as pool:
        for i, column in enumerate(pool.map(lambda c: problem.column(base, c), candidates)):
            raw.append(column.astype(np.float32))
            tell(f"{stage.name}: effect of {candidates[i].label}", (i + 1) / len(candidates))
    library = Library(problem, candidates, raw)
    clean(problem, library, base)
    base = problem.point(Model(), base.poses)
    library.rewhiten(base)
    return Prepared(problem, library, base, coarse_rpm), reasons


def _coarse(problem: Problem, base: Point) -> float | None:
    """Return the step of coarse wheel speeds where the replay of smooth ones misses grossly.

    A loop on a coarse speed hunts about its set-point, and no replay hunts in step with it for
    long: the measured values themselves tell the step, and the ripple counts as noise.
    """
    names = [n for n in SPEEDS if n in problem.stack.edges]
    if not isinstance(problem.stage, DriveStage) or base.deviance < GROSS * len(base.left):
        return None
    parts = [problem.stack.edges[n] for n in names]
    values = problem.stack.values
    step = coarse_step([values[e] for e in parts], [base.predicted[e] for e in parts])
    rounded = [problem.readings[n].step for n in names if problem.readings[n].step > 0.0]
    if step is None or not rounded:
        return step
    own = all(abs(step - one) < READING_SAME_STEP * one for one in rounded)
    return step if own and _answered(problem, base, step) else None


def _answered(problem: Problem, base: Point, step_rpm: float) -> bool:
    """Return whether the duties answer every step of the speeds, as those of a coarse loop do.

    The steps of rounded readings are those of the log alone.
    """
    stack = problem.stack
    edges = [stack.edges[n] for n in DUTIES if n in stack.edges]
    coarse = problem.predict({"encoder_quantization": step_rpm}, base.poses)

    def ripple(duty: Array) -> float:
        return float(np.mean(np.concatenate([np.abs(np.diff(duty[e])) for e in edges])))

    if not edges:
        return False
    smooth, stepped = ripple(base.predicted), ripple(coarse)
    return ripple(stack.values) - smooth > RIPPLE_ANSWERED * (stepped - smooth)


def clean(problem: Problem, library: Library, point: Point) -> None:
    """Learn the noise from what no cause at all can explain, so that no effect hides in it."""
    library.rewhiten(point)
    raw = library.effect(library.ridge(point), slice(None))
    left = problem.residual(point.predicted) - raw
    nuisance = problem.nuisance(point.predicted, point.poses)
    if nuisance is not None:
        step = problem.pose_step(problem.whiten(left), nuisance)
        left = left - (nuisance * step[problem.stack.segment]).sum(axis=1)
    problem.learn_noise(left)
