"""What a log must hold before a cause can be judged at all."""

from collections.abc import Iterable, Mapping
from enum import StrEnum
from typing import Final

from hilserver.diagnosis.catalogue.candidate import Candidate


class Need(StrEnum):
    """What a log may lack, as a reader of the findings is told; of several the last one counts."""

    SPEED = "no wheel speed in the log"
    DUTY = "no duty in the log"
    VOLTAGE = "no battery voltage in the log"
    POSITION = "no position in the log"
    PLACE = "the navigation's frame begins anew with every segment"
    YAW = "no navigation yaw in the log"
    GYRO = "no turn rate in the log"
    STAMPS = "the log has no time stamps"


NEEDED_BY: Final[Mapping[Need, frozenset[str]]] = {
    # other loads still show without duty where they keep wheels from their set-points
    Need.DUTY: frozenset({"dead_zone", "stribeck_friction", "encoder_scale"}),
    Need.VOLTAGE: frozenset({"battery_sag"}),
    Need.POSITION: frozenset({
        "longitudinal_slip", "acceleration_slip", "side_slip", "icr_offset", "wheel_misalignment",
        "floor_slope", "surface_change", "nav_lever_arm", "nav_latency", "nav_scale",
        "nav_outliers", "nav_position_bias", "nav_frame_yaw",
    }),
    Need.PLACE: frozenset({
        "surface_change", "floor_slope", "heading_distortion", "nav_position_bias",
    }),
    Need.YAW: frozenset({"nav_frame_yaw", "yaw_latency", "heading_distortion"}),
    Need.GYRO: frozenset({"gyro_bias", "gyro_scale", "imu_latency"}),
    Need.STAMPS: frozenset({
        "nav_latency", "yaw_latency", "imu_latency", "actuation_delay", "clock_offset",
        "control_period",
    }),
}  # fmt: skip
"""Causes by what they need; wheel speeds all causes of the drive do."""

NOT_OF_ITS_OWN: Final[Mapping[str, str]] = {
    "friction_anisotropy": "in steady turns it is the same as rotation_gain and icr_offset",
    "traction_slip": "on one floor it is the same as nav_scale",
    "backlash": "the play between motor and wheel is not tested",
    "missed_ticks": "the log has no tick counter",
}
"""Why causes without a candidate are not judged."""


def lacking(missing: Iterable[Need], candidates: Iterable[Candidate]) -> dict[str, str]:
    """Return why causes cannot be judged where something is missing.

    Parameters
    ----------
    candidates : iterable of Candidate
        All of one stage.
    """
    every = frozenset(c.cause for c in candidates)
    reasons: dict[str, str] = {}
    for need in sorted(missing, key=list(Need).index):
        reasons |= dict.fromkeys(NEEDED_BY.get(need, every), need.value)
    return reasons
