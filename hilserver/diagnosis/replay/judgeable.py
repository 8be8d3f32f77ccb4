"""Which causes a log can judge with its channels, and why others are not judged."""

from collections.abc import Callable, Mapping
from typing import Final

from hilserver.diagnosis.catalogue.candidate import Candidate, StageName
from hilserver.diagnosis.catalogue.traits import Need, lacking, traits_of
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.replay.positions import begins_anew
from hilserver.diagnosis.replay.stage import Stage
from hilserver.measured.channels import (
    DUTIES,
    GYRO,
    POSITION,
    SETPOINTS,
    SPEEDS,
    TWIST,
    VOLTAGE,
    YAW,
)
from hilserver.measured.data import MeasuredLog

NO_STAGE: Final[Mapping[StageName, str]] = {
    "drive": "no set-points with wheel speeds, or no plant.process in the mapping",
    "pose": "no pose and no turn rate in the log, or no wheel speed on both sides (of a mecanum"
    " robot on every wheel)",
}
"""Why causes are not judged if the log does not allow their stage."""


WITHOUT_CANDIDATE: Final = frozenset({"nav_outliers"})  # judged on single samples
UNSEEN: Final = "hardly excited: this drive cannot show it"
LOST_SETPOINTS: Final = (
    "the log does not contain the set-points that the robot received"
)


def absent(log: MeasuredLog) -> dict[StageName, str]:
    """Return which channels of a log are missing for each stage, if it does not allow one."""
    commanded = log.has(*SETPOINTS) or log.has(*TWIST)
    turning = any(name in log for name in (*SPEEDS, *DUTIES))
    posed = log.has(*POSITION) or YAW in log or GYRO in log
    of_drive = [
        *(() if commanded else ("no set-points in the log",)),
        *(() if turning else ("no wheel speed in the log",)),
        *(() if log.drive_is_known else ("no plant.process in the mapping",)),
    ]
    of_pose = (
        "no wheel speed on both sides"
        if posed
        else "no pose and no turn rate in the log"
    )
    return {"drive": ", ".join(of_drive) or NO_STAGE["drive"], "pose": of_pose}


def of_kinematics(why: str | None) -> dict[str, str]:
    """Return the reason for all causes of the pose if the log shows none, see `checks.frame`."""
    if why is None:
        return {}
    return {
        n: f"the robot {why}"
        for n, c in CAUSES.items()
        if c.physical and c.stage == "pose"
    }


def of_the_log(reason: str) -> bool:
    """Return whether a cause was not judged because of what the recording lacks."""
    return reason.startswith(("no ", "the robot ")) or reason in {*Need, LOST_SETPOINTS}


HOLDS: Final[Mapping[Need, Callable[[MeasuredLog], bool]]] = {
    Need.SPEED: lambda log: any(n in log for n in SPEEDS),
    Need.DUTY: lambda log: any(n in log for n in DUTIES),
    Need.VOLTAGE: lambda log: VOLTAGE in log,
    Need.POSITION: lambda log: log.has(*POSITION),
    Need.PLACE: lambda log: not begins_anew(log),
    Need.STEADY: lambda log: not log.pose_errors_last,
    Need.YAW: lambda log: YAW in log,
    Need.GYRO: lambda log: GYRO in log,
    Need.STAMPS: lambda log: log.has_stamps,
}
"""Whether a log holds what causes need."""


def judged_candidates(stage: Stage) -> tuple[list[Candidate], dict[str, str]]:
    """Return the candidates that a stage's channels can judge, and why others are not judged."""
    found = stage.candidates()
    reasons = dict(stage.robot.meaningless)
    missing = [need for need in stage.needs if not HOLDS[need](stage.log)]
    reasons |= lacking(missing, [c.cause for c in found])
    return [c for c in found if c.cause not in reasons], reasons


def splits(log: MeasuredLog, candidate: Candidate) -> bool:
    """Return whether a region of the floor contains a fair part of the drive, but not all."""
    if candidate.region is None:
        return True
    x_min, x_max, y_min, y_max = candidate.region
    x, y = (log[n].values for n in POSITION)
    if len(x) != len(y):
        return False
    inside = (x >= x_min) & (x <= x_max) & (y >= y_min) & (y <= y_max)
    return bool(0.15 < inside.mean() < 0.85)


def vocabulary_reasons(
    judged: set[str],
    reasons: dict[str, str],
    stages: set[str],
    missing: Mapping[StageName, str] = NO_STAGE,
    unseen: str = "",
) -> dict[str, str]:
    """Return a reason for every physical cause that was not judged, in the vocabulary's order.

    Parameters
    ----------
    missing : mapping of str to str
        Why there is no stage, see `absent`.
    unseen : str, optional
        Why all others that were not judged are not.
    """
    out = dict(reasons)
    for name, cause in CAUSES.items():
        if name in judged or name in out:
            continue
        if why := traits_of(name).not_judged:
            out[name] = why
            continue
        if not cause.physical:
            continue
        if cause.stage not in stages:
            out[name] = missing[cause.stage]
        elif unseen and name not in WITHOUT_CANDIDATE:
            out[name] = unseen
    order = {name: place for place, name in enumerate(CAUSES)}
    left = sorted(
        out.keys() - judged, key=lambda name: (order.get(name, len(order)), name)
    )
    return {name: out[name] for name in left}
