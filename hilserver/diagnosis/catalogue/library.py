"""The causes that a diagnosis can name, as directions in which the plant can be changed.

A candidate has one to four parameters and a fixed shape. A cause whose effect is not linear (a
delay, a limit, a region of the floor) has several candidates, one per shape or start value; the
screen takes the best of them.
"""

import math
from collections.abc import Collection
from dataclasses import replace

from hilserver.diagnosis.catalogue.candidate import (
    Candidate,
    Region,
    StageName,
    several,
    single,
    start_grid,
    wave,
)
from hilserver.diagnosis.catalogue.vocabulary import SPEED_SCALES

DELAYS_S = (0.01, 0.04, 0.15, 0.4)
LATE_S = (0.15, 0.4)
"""Far from zero a latency is no longer linear."""
PERIODS_S = (0.002, 0.003, 0.005, 0.007, 0.01, 0.013)
USUAL_PERIODS_S = (0.0015, 0.0025, 0.004, 0.006, 0.008, 0.009, 0.011, 0.012, 0.0125, 0.014)
QUANTA_RPM = (0.25, 0.5, 1.0)
RATES_RPM_S = (80.0, 150.0, 400.0)
LIMITS_PCT = (85.0, 65.0, 45.0)
MEASURED = 0.05
"""Prior deviation of what somebody measured or counted: radii, distances between anchors, the
increments of a turn."""


def drive_candidates(limit_pct: float) -> list[Candidate]:
    """Return the candidates that set-points, wheel speeds and duties judge."""
    stage: StageName = "drive"
    found = [
        single("process_gain", stage, 0.02, 0.005, -0.6, 2.0),
        single("time_constant", stage, 0.05, 0.02, -0.7, 3.0),
        single("coulomb_friction", stage, 0.5, 0.2, 0.0, 60.0),
        single("viscous_load", stage, 0.02, 0.005, 0.0, 2.0),
        single("dead_zone", stage, 0.5, 0.25, 0.0, 40.0),
        single("battery_sag", stage, 0.3, 0.15, 0.0, 3.0),
        single("controller_gains.p", stage, -0.05, 0.03, -0.9, 2.0),
        single("controller_gains.i", stage, -0.05, 0.05, -0.9, 3.0),
        several(
            "controller_gains",
            "controller_gains",
            stage,
            ("controller_gains.p", "controller_gains.i"),
            (-0.05, -0.05),
            0.05,
            None,
            -0.9,
            3.0,
        ),
    ]
    for wheel, term in enumerate(SPEED_SCALES.values()):
        found.append(_of_wheel("wheel_load", "f", wheel, 1.0, 0.4, 0.0, 60.0))
        found.append(_encoder(wheel))
        found.append(
            replace(
                single(term, stage, 0.01, 0.005, 0.3, 3.0),
                cause="unit_error",
                start=(1.0,),
                null=(1.0,),
            )
        )
    found += [_stribeck(n_s) for n_s in (3.0, 6.0, 12.0)]
    limits = [limit for limit in LIMITS_PCT if limit < limit_pct]
    found += start_grid("saturation_limit", stage, 100.0, limits, -2.0, 1.0, 5.0, 99.0)
    found += start_grid("actuation_delay", stage, 0.0, DELAYS_S, 0.002, 0.002, 0.0, 0.9)
    found += start_grid("setpoint_rate_limit", stage, 1e9, RATES_RPM_S, -10.0, 0.0, 1.0, 1e5)
    periods = start_grid("control_period", stage, 0.001, PERIODS_S, 0.001, 0.0015, 0.001, 0.02)
    found += [replace(c, tried=USUAL_PERIODS_S) for c in periods]
    found += start_grid("encoder_filter", stage, 0.0, (0.005, 0.02), 0.001, 0.001, 0.0, 0.2)
    found += start_grid("encoder_quantization", stage, 0.0, QUANTA_RPM, 0.1, 0.2, 0.0, 20.0)
    return found


def pose_candidates(place: Region | None) -> list[Candidate]:
    """Return the candidates that pose and turn rate judge.

    Parameters
    ----------
    place : tuple of float or None
        Where the robot drove: x_min, x_max, y_min, y_max [m]; None without a position.
    """
    stage: StageName = "pose"
    found = [
        replace(single("wheel_radius", stage, 0.01, 0.002, -0.5, 1.0), prior=MEASURED),
        # 10 m with it cost about half the heading of a full turn with the least rotation_gain
        single("wheel_radius_difference", stage, 0.005, 0.0005, -0.5, 0.5),
        single("rotation_gain", stage, 0.01, 0.003, -0.9, 3.0),
        single("rotation_gain_speed", stage, 0.05, 0.02, -2.0, 5.0),
        single("rotation_gain_radius", stage, 0.05, 0.02, -0.95, 5.0),
        single("body_lag", stage, 0.02, 0.008, 0.0, 1.5),
        single("longitudinal_slip", stage, 0.03, 0.01, -0.5, 2.0),
        single("acceleration_slip", stage, 0.02, 0.01, 0.0, 2.0),
        single("side_slip", stage, 0.03, 0.015, -2.0, 2.0),
        single("icr_offset", stage, 0.02, 0.006, -0.5, 0.5),
        single("wheel_misalignment", stage, 0.01, 0.003, -0.5, 0.5),
        single("nav_frame_yaw", stage, 0.01, 0.005, -3.2, 3.2),
        single("nav_latency", stage, 0.02, 0.008, 0.0, 1.5),
        single("yaw_latency", stage, 0.02, 0.01, 0.0, 1.5),
        replace(single("nav_scale", stage, 0.01, 0.003, -0.5, 1.0), prior=MEASURED),
        single("gyro_bias", stage, 0.002, 0.0005, -1.0, 1.0),
        single("gyro_scale", stage, 0.01, 0.003, -0.95, 3.0),
        single("imu_latency", stage, 0.01, 0.004, 0.0, 1.5),
        *start_grid("imu_latency", stage, 0.0, LATE_S, 0.01, 0.004, 0.0, 1.5),
        *start_grid("yaw_latency", stage, 0.0, LATE_S, 0.02, 0.01, 0.0, 1.5),
        *start_grid("nav_latency", stage, 0.0, LATE_S, 0.02, 0.008, 0.0, 1.5),
        replace(single("shift.nav", stage, 0.02, 0.01, -1.5, 1.5), cause="clock_offset"),
        several(
            "floor_slope",
            "floor_slope",
            stage,
            ("floor_slope.x", "floor_slope.y"),
            (0.005, 0.005),
            0.002,
            None,
            -0.5,
            0.5,
        ),
        several(
            "nav_lever_arm",
            "nav_lever_arm",
            stage,
            ("nav_lever_arm.x", "nav_lever_arm.y"),
            (0.02, 0.02),
            0.006,
            None,
            -2.0,
            2.0,
        ),
        wave(
            "heading_distortion",
            "heading_distortion.1",
            "heading_distortion.a1",
            "heading_distortion.phase1",
            0.005,
        ),
        wave(
            "heading_distortion",
            "heading_distortion.2",
            "heading_distortion.a2",
            "heading_distortion.phase2",
            0.005,
        ),
        wave("wheel_runout", "wheel_runout", "wheel_runout.amplitude", "wheel_runout.phase", 0.005),
    ]
    if place is not None:
        found += _surfaces(place)
        found += [
            replace(
                several(
                    "nav_position_bias",
                    f"nav_position_bias@{length:g}",
                    stage,
                    ("nav_position_bias.amplitude",),
                    (0.02,),
                    0.02,
                    {"nav_position_bias.wavelength": length},
                    -5.0,
                    5.0,
                ),
                hidden=1,
            )
            for length in (3.0, 5.0, 8.0, 12.0)
        ]
    return found


def roller_candidates() -> list[Candidate]:
    """Return what the pose of a mecanum robot judges besides: it drives ahead and to the side."""
    return [
        single("traction_slip", "pose", 0.02, 0.01, -0.5, 1.0),
        single("roller_slip", "pose", 0.02, 0.01, -0.5, 1.0),
    ]


def encoders(wheels: Collection[int]) -> list[Candidate]:
    """Return encoders that show too much for the pose of a mecanum robot to judge: of any wheel."""
    return [replace(_encoder(wheel), stage="pose", prior=MEASURED) for wheel in wheels]


def side_encoders(wheels: Collection[int]) -> list[Candidate]:
    """Return encoders that show too much for the pose to judge: one of each side.

    Parameters
    ----------
    wheels : collection of int
        Those with a speed in the log. Which of two on a side it is, the pose does not tell.
    """
    sides = [sorted({first, first + 1} & set(wheels)) for first in (0, 2)]
    return [
        replace(
            _encoder(side[0]),
            stage="pose",
            prior=MEASURED,
            undecided={"encoder_scale.wheel": (side[0], side[1])} if len(side) > 1 else {},
        )
        for side in sides
        if side
    ]


def _encoder(wheel: int) -> Candidate:
    return _of_wheel("encoder_scale", "a", wheel, 0.01, 0.005, -0.6, 2.0)


def _of_wheel(
    cause: str, part: str, wheel: int, step: float, least: float, low: float, high: float
) -> Candidate:
    fixed = {f"{cause}.wheel": float(wheel)}
    names = (f"{cause}.{part}",)
    return several(cause, f"{cause}@{wheel}", "drive", names, (step,), least, fixed, low, high)


def _stribeck(n_s: float) -> Candidate:
    candidate = several(
        "stribeck_friction",
        f"stribeck_friction@{n_s:.3g}",
        "drive",
        ("stribeck_friction.f_s",),
        (1.0,),
        0.5,
        {"stribeck_friction.n_s": n_s},
        0.0,
        60.0,
    )
    return replace(
        candidate, hidden=1, moved=lambda shift: _stribeck(min(max(n_s * math.exp(shift), 0.5), 40))
    )


def _surfaces(place: Region) -> list[Candidate]:
    """Part of the floor, cut at several places, either side of the cut."""
    x_min, x_max, y_min, y_max = place
    return [
        _surface(axis, side, low + share * (high - low))
        for axis, low, high in (("x", x_min, x_max), ("y", y_min, y_max))
        for share in (0.25, 0.375, 0.5, 0.625, 0.75)
        for side in ("min", "max")
    ]


def _surface(axis: str, side: str, edge: float) -> Candidate:
    ends = {"x_min": -1e3, "x_max": 1e3, "y_min": -1e3, "y_max": 1e3, f"{axis}_{side}": edge}
    candidate = several(
        "surface_change",
        f"surface_change@{axis}_{side}={edge:.3f}",
        "pose",
        ("surface_change.k_om", "surface_change.v"),
        (0.05, 0.05),
        0.03,
        {f"surface_change.{key}": value for key, value in ends.items()},
        -0.9,
        3.0,
    )
    x_min, x_max, y_min, y_max = ends.values()
    return replace(
        candidate,
        hidden=2,
        moved=lambda shift_m: _surface(axis, side, edge + shift_m),
        region=(x_min, x_max, y_min, y_max),
    )
