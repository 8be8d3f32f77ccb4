"""A robot as one record of numbers in the units of config.yaml, and the reasons to refuse one.

`constants.compute` turns it into what a tick needs. A term that is off has its null value, or NaN.
"""

import math
from collections.abc import Iterator
from dataclasses import fields
from types import SimpleNamespace
from typing import Any, Final

from hilserver.compiled.records import Record
from hilserver.plant import parts
from hilserver.plant.errors import PlantError
from hilserver.plant.friction import anisotropy
from hilserver.plant.parameters import GEOMETRIC_GAINS, RobotParameters
from hilserver.plant.terms import TERMS, complete

PARTS: Final = {
    "": RobotParameters,
    "controller_": parts.Controller,
    "process_": parts.Process,
    "imu_": parts.Imu,
    "battery_": parts.Battery,
    "tof_": parts.RangeFinders,
    "nav_": parts.Navigation,
}
"""Where the numbers of the record come from, by the prefix of their names."""
MORE: Final = (
    "rotation_gain",  # K_om; NaN: from the geometry
    # flags
    "geometric_diff", "mecanum", "body_wheels", "exclusive", "euler", "imu_enabled",
    "battery_enabled", "tof_enabled", "nav_enabled",
    "yaw_sign",
    # effect of friction_anisotropy on K_om and X_ICR
    "anisotropy_factor", "anisotropy_shift_m",
)  # fmt: skip
NUMBERS: Final = {
    prefix: [item.name for item in fields(part) if "bounds" in item.metadata]
    for prefix, part in PARTS.items()
}
TERM_NAMES: Final = {name: f"term_{name.replace('.', '_')}" for name in TERMS}


def _names() -> Iterator[str]:
    for prefix, names in NUMBERS.items():
        yield from (prefix + name for name in names)
    yield from TERM_NAMES.values()
    yield from MORE


Physical: Any = type(
    "Physical", (Record,), {"__annotations__": dict.fromkeys(_names(), float)}
)
"""The record itself."""

FITS: Final = 0
(
    UNSTABLE, NO_FILTER, COARSE, SHORT_CONTROL, FAR_CENTRE, ENCODER_WHEEL, LOAD_WHEEL, ACTUATION,
    IMU_DELAY, NAV_DELAY, YAW_DELAY, NAV_RATE, YAW_SIGN,
) = range(1, 14)  # fmt: skip
REASONS: Final = {
    UNSTABLE: "the wheel speed loop would be unstable",
    NO_FILTER: "plant.controller.k_p must be above 0 when k_d is",
    COARSE: "plant.process.t2_s is too short for discretization euler",
    SHORT_CONTROL: "terms.control_period is below the plant slice",
    FAR_CENTRE: "plant.icr_offset_m must be below half the wheelbase",
    ENCODER_WHEEL: "terms.encoder_scale.wheel must be 0 fl, 1 rl, 2 fr or 3 rr",
    LOAD_WHEEL: "terms.wheel_load.wheel must be 0 fl, 1 rl, 2 fr or 3 rr",
    ACTUATION: "terms.actuation_delay is longer than what is remembered",
    IMU_DELAY: "terms.imu_latency is longer than what is remembered",
    NAV_DELAY: "the latency of the position is longer than what is remembered",
    YAW_DELAY: "the latency of the yaw is longer than what is remembered",
    NAV_RATE: "sensors.nav.rate_hz does not fit its slice",
    YAW_SIGN: "kinematics.yaw_sign must be -1 or 1",
}


def physical(robot: RobotParameters) -> SimpleNamespace:
    """Return the numbers of a robot by their names in `Physical`.

    PlantError if friction_anisotropy does not fit it.
    """
    v = SimpleNamespace()
    own = (
        robot,
        robot.controller,
        robot.process,
        robot.imu,
        robot.battery,
        robot.tof,
        robot.nav,
    )
    for part, (prefix, names) in zip(own, NUMBERS.items(), strict=True):
        for name in names:
            v.__dict__[prefix + name] = _number(getattr(part, name))
    terms = complete(robot.terms)
    v.__dict__.update((name, _number(terms[term])) for term, name in TERM_NAMES.items())
    gain = robot.rotation_gain
    v.rotation_gain = _number(None if gain in GEOMETRIC_GAINS else robot.k_om)
    v.geometric_diff = float(gain == "geometric_diff")
    v.mecanum, v.body_wheels = float(robot.is_mecanum), float(robot.body_wheels)
    v.exclusive, v.euler = float(robot.exclusive_twist), float(robot.loop.euler)
    v.imu_enabled, v.battery_enabled = (
        float(robot.imu.enabled),
        float(robot.battery.enabled),
    )
    v.tof_enabled, v.nav_enabled = float(robot.tof.enabled), float(robot.nav.enabled)
    v.yaw_sign = float(robot.yaw_sign)
    v.anisotropy_factor, v.anisotropy_shift_m = _anisotropy(robot, v)
    return v


def _number(value: float | None) -> float:
    return math.nan if value is None else float(value)


def _anisotropy(robot: RobotParameters, v: SimpleNamespace) -> tuple[float, float]:
    ratio, offset_m = (
        v.term_friction_anisotropy_ratio,
        v.term_friction_anisotropy_offset,
    )
    if ratio == 1.0 and offset_m == 0.0:
        return 1.0, 0.0
    if robot.wheelbase_m is None:
        raise PlantError(
            "plant.terms.friction_anisotropy: needs plant.wheelbase_m; two wheels do not scrub."
        )
    if abs(offset_m) >= robot.wheelbase_m / 2.0:
        raise PlantError(
            f"plant.terms.friction_anisotropy.offset: {offset_m:g} m must be below half the "
            f"wheelbase, {robot.wheelbase_m / 2.0:g} m."
        )
    return anisotropy(robot.wheelbase_m, robot.track_m, ratio, offset_m)
