"""Which causes a log can judge by its channels, and why others are not judged."""

import numpy as np

from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.library import (
    drive_candidates,
    encoders,
    pose_candidates,
    roller_candidates,
    side_encoders,
)
from hilserver.diagnosis.catalogue.vocabulary import CAUSES
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.measured.channels import DUTIES, GYRO, POSITION, SPEEDS, YAW
from hilserver.measured.data import MeasuredLog

NEEDS_DUTY = {"dead_zone", "stribeck_friction", "encoder_scale"}
"""Other loads still show without duty where they keep wheels from their set-points."""
NEEDS_POSITION = {
    "wheel_radius",
    "longitudinal_slip",
    "acceleration_slip",
    "traction_slip",
    "roller_slip",
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
NOT_OF_ITS_OWN = {
    "friction_anisotropy": "in steady turns it is the same as rotation_gain and icr_offset",
    "traction_slip": "on one floor it is the same as nav_scale",  # but for mecanum wheels
    "backlash": "the play between motor and wheel is not tested",
    "missed_ticks": "the log has no tick counter",
}


def judged_candidates(stage: DriveStage | PoseStage) -> tuple[list[Candidate], dict[str, str]]:
    """Return the candidates that a stage's channels can judge, and why others are not judged."""
    log = stage.log
    reasons: dict[str, str] = dict(stage.robot.meaningless)
    if isinstance(stage, DriveStage):
        found = drive_candidates(100.0)
        if not any(n in log for n in SPEEDS):
            reasons |= dict.fromkeys((c.cause for c in found), "no wheel speed in the log")
        if not any(n in log for n in DUTIES):
            reasons |= dict.fromkeys(NEEDS_DUTY, "no duty in the log")
        if "battery.voltage_v" not in log:
            reasons["battery_sag"] = "no battery voltage in the log"
    else:
        found = _of_the_pose(stage)
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


def _of_the_pose(stage: PoseStage) -> list[Candidate]:
    found = pose_candidates(_place(stage.log))
    if stage.robot.is_mecanum:
        return found + roller_candidates() + encoders(stage.encoders)
    return found + side_encoders(stage.encoders)


def _place(log: MeasuredLog) -> tuple[float, float, float, float] | None:
    if not log.has(*POSITION):
        return None
    x, y = (log[n].values for n in POSITION)
    (a, b), (c, d) = (np.quantile(v, [0.02, 0.98]) for v in (x, y))
    return float(a), float(b), float(c), float(d)


def splits(log: MeasuredLog, candidate: Candidate) -> bool:
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


def vocabulary_reasons(
    judged: set[str], reasons: dict[str, str], stages: set[str]
) -> dict[str, str]:
    """Return a reason for every physical cause that was not judged, in the vocabulary's order."""
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
            out[name] = "no pose and no turn rate in the log, or too few wheel speeds"
    order = {name: place for place, name in enumerate(CAUSES)}
    left = sorted(out.keys() - judged, key=lambda name: (order.get(name, len(order)), name))
    return {name: out[name] for name in left}
