"""The causes that a diagnosis can name, as directions in which the plant can change.

A candidate has one to four parameters and a fixed shape. A cause with a non-linear effect (a delay,
a limit, a region of the floor) has several candidates, one per shape or start value; the screen
takes the best of them.
"""

import math
from collections.abc import Collection, Sequence
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
from hilserver.diagnosis.catalogue.vocabulary import LATENCIES, SPEED_SCALES

LATE_S = (0.15, 0.4)  # far from zero, a latency does not act linearly
PERIODS_S = (0.002, 0.003, 0.005, 0.007, 0.01, 0.013)
USUAL_PERIODS_S = (
    0.0015,
    0.0025,
    0.004,
    0.006,
    0.008,
    0.009,
    0.011,
    0.012,
    0.0125,
    0.014,
)
MEASURED = 0.05
"""Prior deviation of what somebody measured or counted: radii, distances between anchors,
encoder increments per turn."""
PRIORS = {"wheel_radius": MEASURED, "nav_scale": MEASURED}
OF_THE_DRIVE = (
    ("process_gain", 0.02, 0.005, -0.6, 2.0),
    ("time_constant", 0.05, 0.02, -0.7, 3.0),
    ("coulomb_friction", 0.5, 0.2, 0.0, 60.0),
    ("viscous_load", 0.02, 0.005, 0.0, 2.0),
    ("dead_zone", 0.5, 0.25, 0.0, 40.0),
    ("battery_sag", 0.3, 0.15, 0.0, 3.0),
    ("controller_gains.p", -0.05, 0.03, -0.9, 2.0),
    ("controller_gains.i", -0.05, 0.05, -0.9, 3.0),
)
STARTS_OF_THE_DRIVE = (
    ("saturation_limit", 100.0, (85.0, 65.0, 45.0), -2.0, 1.0, 5.0, 99.0),
    ("actuation_delay", 0.0, (0.01, 0.04, 0.15, 0.4), 0.002, 0.002, 0.0, 0.9),
    ("setpoint_rate_limit", 1e9, (80.0, 150.0, 400.0), -10.0, 0.0, 1.0, 1e5),
    ("control_period", 0.001, PERIODS_S, 0.001, 0.0015, 0.001, 0.02),
    ("encoder_filter", 0.0, (0.005, 0.02), 0.001, 0.001, 0.0, 0.2),
    ("encoder_quantization", 0.0, (0.25, 0.5, 1.0), 0.1, 0.2, 0.0, 20.0),
)
"""Null and start values, then the same columns: none of these is linear."""
OF_THE_POSE = (
    ("wheel_radius", 0.01, 0.002, -0.5, 1.0),
    # 10 m with it cost about half the heading of a full turn with the least rotation_gain
    ("wheel_radius_difference", 0.005, 0.0005, -0.5, 0.5),
    ("rotation_gain", 0.01, 0.003, -0.9, 3.0),
    ("rotation_gain_speed", 0.05, 0.02, -2.0, 5.0),
    ("rotation_gain_radius", 0.05, 0.02, -0.95, 5.0),
    ("body_lag", 0.02, 0.008, 0.0, 1.5),
    ("longitudinal_slip", 0.03, 0.01, -0.5, 2.0),
    ("acceleration_slip", 0.02, 0.01, 0.0, 2.0),
    ("side_slip", 0.03, 0.015, -2.0, 2.0),
    ("icr_offset", 0.02, 0.006, -0.5, 0.5),
    ("wheel_misalignment", 0.01, 0.003, -0.5, 0.5),
    ("nav_frame_yaw", 0.01, 0.005, -3.2, 3.2),
    ("nav_latency", 0.02, 0.008, 0.0, 1.5),
    ("yaw_latency", 0.02, 0.01, 0.0, 1.5),
    ("nav_scale", 0.01, 0.003, -0.5, 1.0),
    ("gyro_bias", 0.002, 0.0005, -1.0, 1.0),
    ("gyro_scale", 0.01, 0.003, -0.95, 3.0),
    ("imu_latency", 0.01, 0.004, 0.0, 1.5),
)
"""Step of the finite differences, least size worth a name, lower and upper bound."""


def drive_candidates(periods_s: Sequence[float] = ()) -> list[Candidate]:
    """Return the candidates that set-points, wheel speeds and duties judge.

    Parameters
    ----------
    periods_s : sequence of float
        Of the controller, as the duties show them.
    """
    stage: StageName = "drive"
    found = [single(name, stage, *sizes) for name, *sizes in OF_THE_DRIVE]
    gains, both = "controller_gains", ("controller_gains.p", "controller_gains.i")
    found.append(
        several(gains, gains, stage, both, (-0.05, -0.05), 0.05, None, -0.9, 3.0)
    )
    for wheel, term in enumerate(SPEED_SCALES.values()):
        found.append(_of_wheel("wheel_load", "f", wheel, 1.0, 0.4, 0.0, 60.0))
        found.append(_encoder(wheel))
        scale = single(term, stage, 0.01, 0.005, 0.3, 3.0)
        found.append(replace(scale, cause="unit_error", start=(1.0,), null=(1.0,)))
    found += [_stribeck(n_s) for n_s in (3.0, 6.0, 12.0)]
    for name, null, values, *sizes in STARTS_OF_THE_DRIVE:
        found += start_grid(single(name, stage, *sizes), null, values)
    tried = {"control_period": (*USUAL_PERIODS_S, *periods_s)}
    return [replace(c, tried=tried.get(c.cause, ())) for c in found]


def pose_candidates(place: Region | None) -> list[Candidate]:
    """Return the candidates that pose and turn rate judge.

    Parameters
    ----------
    place : tuple of float or None
        Where the robot drove: x_min, x_max, y_min, y_max [m]; None without a position.
    """
    sizes = {name: own for name, *own in OF_THE_POSE}
    found = [replace(single(name, "pose", *own), prior=PRIORS.get(name, math.inf))
             for name, own in sizes.items()]  # fmt: skip
    for name in reversed(tuple(LATENCIES.values())):
        found += start_grid(single(name, "pose", *sizes[name]), 0.0, LATE_S)
    found.append(
        replace(
            single("shift.nav", "pose", 0.02, 0.01, -1.5, 1.5), cause="clock_offset"
        )
    )
    for name, step, least, most in (
        ("floor_slope", 0.005, 0.002, 0.5), ("nav_lever_arm", 0.02, 0.006, 2.0)
    ):  # fmt: skip
        parts = (f"{name}.x", f"{name}.y")
        found.append(
            several(name, name, "pose", parts, (step, step), least, None, -most, most)
        )
    for k in (1, 2):
        cause = "heading_distortion"
        found.append(
            wave(cause, f"{cause}.{k}", f"{cause}.a{k}", f"{cause}.phase{k}", 0.005)
        )
    cause = "wheel_runout"
    found.append(wave(cause, cause, f"{cause}.amplitude", f"{cause}.phase", 0.005))
    if place is not None:
        found += _surfaces(place) + [
            _position_bias(length_m) for length_m in (3.0, 5.0, 8.0, 12.0)
        ]
    return found


def _position_bias(length_m: float) -> Candidate:
    cause = "nav_position_bias"
    names, fixed = (f"{cause}.amplitude",), {f"{cause}.wavelength": length_m}
    label = f"{cause}@{length_m:g}"
    return replace(
        several(cause, label, "pose", names, (0.02,), 0.02, fixed, -5.0, 5.0), hidden=1
    )


def roller_candidates() -> list[Candidate]:
    """Return what else the pose of a mecanum robot judges, which drives forward and sideways."""
    return [
        single("traction_slip", "pose", 0.02, 0.01, -0.5, 1.0),
        single("roller_slip", "pose", 0.02, 0.01, -0.5, 1.0),
    ]


def encoders(wheels: Collection[int]) -> list[Candidate]:
    """Return encoders that show too much, for the pose of a mecanum robot to judge: any wheel."""
    return [replace(_encoder(wheel), stage="pose", prior=MEASURED) for wheel in wheels]


def side_encoders(wheels: Collection[int]) -> list[Candidate]:
    """Return encoders that show too much, for the pose to judge: one per side.

    Parameters
    ----------
    wheels : collection of int
        Those with a speed in the log. The pose does not show which of two on a side it is.
    """
    sides = [sorted({first, first + 1} & set(wheels)) for first in (0, 2)]
    return [
        replace(
            _encoder(side[0]),
            stage="pose",
            prior=MEASURED,
            undecided={"encoder_scale.wheel": (side[0], side[1])}
            if len(side) > 1
            else {},
        )
        for side in sides
        if side
    ]


def _encoder(wheel: int) -> Candidate:
    return _of_wheel("encoder_scale", "a", wheel, 0.01, 0.005, -0.6, 2.0)


def _of_wheel(
    cause: str,
    part: str,
    wheel: int,
    step: float,
    least: float,
    low: float,
    high: float,
) -> Candidate:
    fixed = {f"{cause}.wheel": float(wheel)}
    names = (f"{cause}.{part}",)
    return several(
        cause, f"{cause}@{wheel}", "drive", names, (step,), least, fixed, low, high
    )


def _stribeck(n_s: float) -> Candidate:
    cause = "stribeck_friction"
    label, names, fixed = f"{cause}@{n_s:.3g}", (f"{cause}.f_s",), {f"{cause}.n_s": n_s}

    def moved(shift: float) -> Candidate:
        return _stribeck(min(max(n_s * math.exp(shift), 0.5), 40))

    made = several(cause, label, "drive", names, (1.0,), 0.5, fixed, 0.0, 60.0)
    return replace(made, hidden=1, moved=moved)


def _surfaces(place: Region) -> list[Candidate]:
    """Part of the floor, cut at several places, on either side of the cut."""
    x_min, x_max, y_min, y_max = place
    return [
        _surface(axis, side, low + share * (high - low))
        for axis, low, high in (("x", x_min, x_max), ("y", y_min, y_max))
        for share in (0.25, 0.375, 0.5, 0.625, 0.75)
        for side in ("min", "max")
    ]


def _surface(axis: str, side: str, edge: float) -> Candidate:
    cause, steps = "surface_change", (0.05, 0.05)
    label, names = f"{cause}@{axis}_{side}={edge:.3f}", (f"{cause}.k_om", f"{cause}.v")
    ends = {
        "x_min": -1e3,
        "x_max": 1e3,
        "y_min": -1e3,
        "y_max": 1e3,
        f"{axis}_{side}": edge,
    }
    fixed = {f"{cause}.{key}": value for key, value in ends.items()}
    x_min, x_max, y_min, y_max = ends.values()

    def moved(shift_m: float) -> Candidate:
        return _surface(axis, side, edge + shift_m)

    made = several(cause, label, "pose", names, steps, 0.03, fixed, -0.9, 3.0)
    return replace(made, hidden=2, moved=moved, region=(x_min, x_max, y_min, y_max))
