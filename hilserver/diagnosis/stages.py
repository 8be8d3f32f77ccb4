"""Makes the regressions of a log: which stages it has, their noise, and all columns."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.candidate import Candidate
from hilserver.diagnosis.checks.support import along
from hilserver.diagnosis.columns import Library
from hilserver.diagnosis.comb import coarse_step
from hilserver.diagnosis.data import MeasuredLog
from hilserver.diagnosis.drive_stage import DUTIES, SPEEDS, DriveStage
from hilserver.diagnosis.library import drive_candidates, pose_candidates
from hilserver.diagnosis.model import Model
from hilserver.diagnosis.pose_stage import GYRO, POSITION, YAW, PoseStage
from hilserver.diagnosis.problem import Point, Problem
from hilserver.diagnosis.screen import GROSS
from hilserver.diagnosis.vocabulary import CAUSES
from hilserver.plant.layout import P_RADIUS_LEFT, P_RADIUS_RIGHT, P_YAW_GAIN
from hilserver.plant.parameters import RobotParameters

Array = NDArray[np.float64]
Tell = Callable[[str, float], None]

NEEDS_DUTY = {"dead_zone", "stribeck_friction"}
"""Other loads still show without duty where they keep wheels from their set-points."""
NEEDS_POSITION = {
    "wheel_radius",
    "longitudinal_slip",
    "acceleration_slip",
    "side_slip",
    "icr_offset",
    "wheel_misalignment",
    "floor_slope",
    "surface_change",
    "nav_lever_arm",
    "nav_latency",
    "nav_scale",
    "nav_outliers",
    "nav_position_bias",
    "nav_frame_yaw",
}
NEEDS_PLACE = {"surface_change", "floor_slope", "heading_distortion", "nav_position_bias"}
NEEDS_YAW = {"nav_frame_yaw", "yaw_latency", "heading_distortion"}
NEEDS_GYRO = {"gyro_bias", "gyro_scale", "imu_latency"}
NEEDS_STAMPS = {
    "nav_latency", "yaw_latency", "imu_latency", "actuation_delay", "clock_offset", "control_period"
}  # fmt: skip


TURNED_RAD_S, STANDS = 0.1, 0.05
"""Turn rate that the wheels must have asked for, and the share of it that is no turn at all."""
MOVED_RAD_S = 0.02
"""Turn rate that is more than the noise of wheel speeds."""
DIMENSIONS = {"wheel_radius_m", "track_m", "wheelbase_m"}


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


def standing(log: MeasuredLog, robot: RobotParameters) -> bool:
    """Return whether the machine did not turn although its wheels did: it stood on a frame.

    Its kinematics cannot be judged then: they would all be wrong by the same whole.
    """
    turn = _asked_turn(log, robot)
    if turn is None or not _turning(turn, TURNED_RAD_S):
        return False
    return abs(float(turn @ log[GYRO].values) / float(turn @ turn)) < STANDS


def without_motion(log: MeasuredLog, robot: RobotParameters) -> bool:
    """Return whether nothing in a log tells of its kinematics: no position, and no turn."""
    turn = _asked_turn(log, robot)
    return turn is not None and not log.has(*POSITION) and not _turning(turn, MOVED_RAD_S)


def _asked_turn(log: MeasuredLog, robot: RobotParameters) -> Array | None:
    """Return the turn rate [rad/s] that the wheels ask for at the gyro's samples."""
    if GYRO not in log or not log.has(*SPEEDS):
        return None
    at = along(log[GYRO])
    left, right = (
        0.5 * sum(np.interp(at, along(log[n]), log[n].values) for n in SPEEDS[part])
        for part in (slice(0, 2), slice(2, 4))
    )
    p = robot.pack()
    rims = p[P_RADIUS_LEFT] * left + p[P_RADIUS_RIGHT] * right
    return np.asarray(p[P_YAW_GAIN] * rims * 2.0 * np.pi / 60.0)


def _turning(turn: Array, least_rad_s: float) -> bool:
    return float(turn @ turn) >= least_rad_s**2 * len(turn)


def on_a_frame(log: MeasuredLog) -> MeasuredLog:
    """Return the log of a machine that stood on a frame without what does not hold there."""
    moved = {*POSITION, YAW, GYRO}
    kept = {name: c for name, c in log.channels.items() if name not in moved}
    note = "the machine did not turn although its wheels did: its kinematics are not judged"
    return replace(log, channels=kept, notices=(*log.notices, note))


def block_length(total_s: float, shortest_s: float, longest_s: float, aim: int) -> float:
    """Return the length of sign-flip blocks that gives about `aim` of them."""
    return float(np.clip(total_s / aim, shortest_s, longest_s))


def drive_is_known(log: MeasuredLog) -> bool:
    """Return whether the configured process and controller are those of the log's machine.

    A mapping that gives the dimensions of another machine but not its process says nothing about
    its motors, and every cause of the drive would be named.
    """
    return "process" in log.plant or not DIMENSIONS & set(log.plant)


def stages_of(log: MeasuredLog, robot: RobotParameters) -> dict[str, DriveStage | PoseStage]:
    """Return the stages that a log has the channels for."""
    total_s = sum(s.end_s - s.start_s for s in log.spans)
    stages: dict[str, DriveStage | PoseStage] = {}
    if DriveStage.judges(log) and drive_is_known(log):
        stages["drive"] = DriveStage(log, robot, block_s=block_length(total_s, 1.0, 5.0, 72))
    if PoseStage.judges(log):
        stages["pose"] = pose_stage(log, robot, stages.get("drive"), {})
    return stages


def pose_stage(
    log: MeasuredLog,
    robot: RobotParameters,
    drive: DriveStage | PoseStage | None,
    terms: dict[str, float],
) -> PoseStage:
    """Return the pose stage, its wheel speeds interpolated by the drive with these terms."""
    total_s = sum(s.end_s - s.start_s for s in log.spans)
    dense = None
    if isinstance(drive, DriveStage):
        dense = (drive, drive.simulate(terms)[0])
    return PoseStage(log, robot, dense, block_s=block_length(total_s, 3.0, 5.0, 72))


def judged_candidates(stage: DriveStage | PoseStage) -> tuple[list[Candidate], dict[str, str]]:
    """Return the candidates that a stage's channels can judge, and why others are not judged."""
    log = stage.log
    reasons: dict[str, str] = {}
    if isinstance(stage, DriveStage):
        found = drive_candidates(100.0)
        if not any(n in log for n in SPEEDS):
            reasons |= dict.fromkeys((c.cause for c in found), "no wheel speed in the log")
        if not any(n in log for n in DUTIES):
            reasons |= dict.fromkeys(NEEDS_DUTY, "no duty in the log")
        if "battery.voltage_v" not in log:
            reasons["battery_sag"] = "no battery voltage in the log"
    else:
        found = pose_candidates(_place(log))
        if not log.has(*POSITION):
            reasons |= dict.fromkeys(NEEDS_POSITION, "no position in the log")
            if YAW in log or GYRO in log:
                reasons.pop("wheel_radius", None)
        if stage.begins_anew:
            text = "the navigation's frame begins anew with every segment"
            reasons |= dict.fromkeys(NEEDS_PLACE, text)
        if YAW not in log:
            reasons |= dict.fromkeys(NEEDS_YAW, "no navigation yaw in the log")
        if GYRO not in log:
            reasons |= dict.fromkeys(NEEDS_GYRO, "no turn rate in the log")
    if not log.has_stamps:
        reasons |= dict.fromkeys(NEEDS_STAMPS, "the log has no time stamps")
    return [c for c in found if c.cause not in reasons], reasons


def _place(log: MeasuredLog) -> tuple[float, float, float, float] | None:
    if not log.has(*POSITION):
        return None
    x, y = (log[n].values for n in POSITION)
    (a, b), (c, d) = (np.quantile(v, [0.02, 0.98]) for v in (x, y))
    return float(a), float(b), float(c), float(d)


def _splits(log: MeasuredLog, candidate: Candidate) -> bool:
    """Return whether a region of the floor holds a fair part of the drive, but not all of it."""
    if candidate.cause != "surface_change":
        return True
    t = candidate.terms(candidate.start)
    x, y = (log[n].values for n in POSITION)
    if len(x) != len(y):
        return False
    inside = (x >= t["surface_change.x_min"]) & (x <= t["surface_change.x_max"])
    inside &= (y >= t["surface_change.y_min"]) & (y <= t["surface_change.y_max"])
    return bool(0.15 < inside.mean() < 0.85)


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
    for name, stage in stages_of(log, robot).items():
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
    candidates = [c for c in candidates if _splits(stage.log, c)]
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
    return coarse_step([values[e] for e in parts], [base.predicted[e] for e in parts])


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


NOT_OF_ITS_OWN = {
    "friction_anisotropy": "in steady turns it is the same as rotation_gain and icr_offset",
    "backlash": "the play between motor and wheel is not looked for",
    "missed_ticks": "the log has no tick counter",
}


def vocabulary_reasons(
    judged: set[str], reasons: dict[str, str], stages: set[str]
) -> dict[str, str]:
    """Return a reason for every physical cause that was not judged."""
    out = dict(reasons)
    for name, cause in CAUSES.items():
        if name in judged or name in out:
            continue
        if name in NOT_OF_ITS_OWN:
            out[name] = NOT_OF_ITS_OWN[name]
            continue
        if not cause.physical:
            continue
        if cause.block in ("drive", "controller") and "drive" not in stages:
            out[name] = "no set-points with wheel speeds, or the mapping gives no plant.process"
        elif cause.block not in ("drive", "controller") and "pose" not in stages:
            out[name] = "no pose and no turn rate in the log"
    return {k: v for k, v in out.items() if k not in judged}
