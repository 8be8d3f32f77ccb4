"""The robot's parameters as checked physical values; `packing` makes the kernels' array of them."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan
from typing import Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from hilserver.plant.errors import PlantError
from hilserver.plant.hall import Solid, default_hall, default_solids
from hilserver.plant.kinematics import nominal_gain
from hilserver.plant.parts import (
    Battery,
    Controller,
    Imu,
    Navigation,
    Process,
    RangeFinders,
)
from hilserver.plant.quantity import quantity, refused
from hilserver.plant.stability import ControlLoop
from hilserver.plant.terms import TERMS, complete
from hilserver.plant.units import RPM_PER_RAD_S

__all__ = [
    "GEOMETRIC_GAINS",
    "ROTATION_GAINS",
    "Battery",
    "Controller",
    "Imu",
    "Navigation",
    "Process",
    "RangeFinders",
    "RobotParameters",
]

ROTATION_GAINS: Final[Mapping[str, float]] = {
    "printed_5_21": 3.229,
    "printed_5_22": 1.995,
    "tile": 1.052,
    "floating_floor": 1.019,
    "carpet_hard": 1.036,
    "carpet_soft": 1.030,
    "steady": 1.12,
}
"""K_om [1/m] by name: printed values, table 5.1, section 5.2.2."""

MECANUM_GEOMETRY: Final[Mapping[str, float]] = {
    "wheel_radius_m": 0.05,
    "wheelbase_m": 0.25,
    "track_m": 0.36,
    "icr_offset_m": 0.0,
}
"""EduArt's mecanum build, edu_robot."""

NOT_FOR_MECANUM: Final = frozenset(
    (
        "friction_anisotropy",
        "icr_offset",
        "rotation_gain_radius",
        "side_slip",
        "backlash",
    )
)
"""Causes in scrubbing wheels, or formulated for the two sides of a robot with such wheels."""

FOR_MECANUM_ALONE: Final = frozenset(("roller_slip",))
"""Causes in rollers, which only mecanum wheels have."""

NOT_FOR_TORQUE: Final = frozenset(("backlash", "viscous_load"))
"""Causes in the part of the process that the mechatronic model computes."""

GEOMETRIC_GAINS: Final = ("geometric_skid", "geometric_diff")


class SpeedRanges(NamedTuple):
    """Limits of the wheel speeds and of the twist."""

    max_rpm: float
    max_linear_m_s: float
    max_angular_rad_s: float
    max_lateral_m_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotParameters:
    """Everything that `robot_step` and the sensor kernels need to know.

    PlantError when a value is not finite, out of range, or the wheel loop would be unstable.
    """

    # plant slice T
    period_s: float = quantity(0.001, "period of its slice", jumps="fixed", gt=0)
    slice_name: str = "plant"  # its name, for messages
    # ``skid``: four wheels that scrub when the robot turns; ``mecanum``: their rollers let it drive
    # sideways, and the centre of rotation is that of the wheels
    drive: Literal["skid", "mecanum"] = "skid"
    wheel_radius_m: float = quantity(
        0.085, "wheel radius r", jumps="velocity duty", ge=0.001, le=10
    )
    # l_x; None for a robot with two wheels
    wheelbase_m: float | None = quantity(
        0.25,
        "l_x, between front and rear wheels; null: two wheels",
        jumps="velocity duty",
        ge=0.001,
        le=100,
    )
    track_m: float = quantity(
        0.31,
        "l_y, between left and right wheels",
        jumps="velocity duty",
        ge=0.001,
        le=100,
    )
    icr_offset_m: float = quantity(
        0.02,
        "X_ICR from the centre of mass, below half the wheelbase",
        jumps="velocity",
        ge=-10,
        le=10,
    )
    max_rpm: float = quantity(
        90.0,
        "largest set-point; all wheels are scaled together",
        jumps="duty",
        gt=0,
        le=10_000,
    )
    safe_ramp_s: float = quantity(
        0.5,
        "time in which the safe state ramps the set-points to zero",
        jumps="fixed",
        ge=0,
        le=60,
    )
    discretization: Literal["exact", "euler"] = "exact"
    exclusive_twist: bool = False
    yaw_sign: int = -1
    # k_om by name or as a number [1/m]; ``geometric_skid`` without l_x means ``geometric_diff``,
    # with mecanum wheels ``1/(l_x + l_y)``
    rotation_gain: str | float = "geometric_skid"
    # the mechatronic model turns the wheels: its drives contain the process of (5.23)
    body_wheels: bool = False
    seed: int = quantity(0, "seed of all noise", jumps="fixed", ge=0, lt=2**53)
    controller: Controller = field(default_factory=Controller)
    process: Process = field(default_factory=Process)
    imu: Imu = field(default_factory=Imu)
    battery: Battery = field(default_factory=Battery)
    tof: RangeFinders = field(default_factory=RangeFinders)
    nav: Navigation = field(default_factory=Navigation)
    # values of `terms.TERMS`; those not given are null
    terms: Mapping[str, float | None] = field(default_factory=dict)
    # shape (4 n,); walls for the range finders
    hall: NDArray[np.float64] = field(
        default_factory=default_hall, compare=False, repr=False
    )
    # obstacles and floors of the mechatronic model
    solids: tuple[Solid, ...] = field(
        default_factory=default_solids, compare=False, repr=False
    )

    def __post_init__(self) -> None:
        _check_numbers(self)
        _check_geometry(self)
        _check_terms(self)
        _check_loop(self)

    @property
    def loop(self) -> ControlLoop:
        """The nominal wheel speed loop."""
        c, process = self.controller, self.process
        return ControlLoop(
            gain=process.gain,
            t1_s=process.t1_s,
            t2_s=process.t2_s,
            k_p=c.k_p,
            k_i=c.k_i,
            k_d=c.k_d,
            derivative_n=c.derivative_n,
            euler=self.discretization == "euler",
        )

    @property
    def k_om(self) -> float:
        """Nominal K_om [1/m] as a number: (5.8), (5.9) or the value of the name."""
        gain = self.rotation_gain
        given = ROTATION_GAINS.get(gain, nan) if isinstance(gain, str) else float(gain)
        wheelbase_m = nan if self.wheelbase_m is None else self.wheelbase_m
        is_diff = gain == "geometric_diff"
        return float(
            nominal_gain(given, is_diff, self.is_mecanum, wheelbase_m, self.track_m)
        )

    @property
    def is_mecanum(self) -> bool:
        """Whether rollers let the robot drive sideways."""
        return self.drive == "mecanum"

    @property
    def meaningless(self) -> dict[str, str]:
        """By cause, why it has no meaning for this robot."""
        reasons: dict[str, str] = {}
        if self.is_mecanum:
            reasons |= dict.fromkeys(
                NOT_FOR_MECANUM, "has no meaning for mecanum wheels"
            )
        else:
            reasons |= dict.fromkeys(
                FOR_MECANUM_ALONE, "needs mecanum wheels (plant.drive)"
            )
        if self.body_wheels:
            torque = "is the body's when mechatronic.driven_by is torque"
            reasons |= dict.fromkeys(NOT_FOR_TORQUE, torque)
        return reasons

    @property
    def max_linear_m_s(self) -> float:
        """Speed straight ahead at max_rpm."""
        return self.wheel_radius_m * self.max_rpm / RPM_PER_RAD_S

    @property
    def max_angular_rad_s(self) -> float:
        """Turn rate on the spot at max_rpm."""
        return 2.0 * self.k_om * self.max_linear_m_s

    @property
    def ranges(self) -> SpeedRanges:
        """The limits that max_rpm sets."""
        lateral_m_s = self.max_linear_m_s if self.is_mecanum else 0.0
        return SpeedRanges(
            self.max_rpm, self.max_linear_m_s, self.max_angular_rad_s, lateral_m_s
        )


def _check_numbers(robot: RobotParameters) -> None:
    plant = {
        "plant": robot,
        "plant.controller": robot.controller,
        "plant.process": robot.process,
    }
    sensors = {
        f"sensors.{name}": getattr(robot, name)
        for name in ("imu", "battery", "tof", "nav")
    }
    for path, part in (plant | sensors).items():
        for name, value, wanted in refused(part):
            raise PlantError(f"{path}.{name}: {wanted}, not {value:g}.")


def _check_geometry(robot: RobotParameters) -> None:
    gain = robot.rotation_gain
    if isinstance(gain, str) and gain not in (*GEOMETRIC_GAINS, *ROTATION_GAINS):
        names = ", ".join((*GEOMETRIC_GAINS, *ROTATION_GAINS))
        raise PlantError(
            f"kinematics.rotation_gain: {gain!r} is not a known name; give a number or {names}."
        )
    if robot.k_om <= 0.0:
        raise PlantError(
            f"kinematics.rotation_gain: K_om must be above 0, not {robot.k_om:g}; "
            "the direction is kinematics.yaw_sign."
        )
    if robot.yaw_sign not in (-1, 1):
        raise PlantError(f"kinematics.yaw_sign: must be -1 or 1, not {robot.yaw_sign}.")
    if robot.drive not in ("skid", "mecanum"):
        raise PlantError(f"plant.drive: must be skid or mecanum, not {robot.drive!r}.")
    if robot.discretization not in ("exact", "euler"):
        raise PlantError(
            f"plant.discretization: must be exact or euler, not {robot.discretization!r}."
        )
    if (
        robot.wheelbase_m is not None
        and abs(robot.icr_offset_m) >= robot.wheelbase_m / 2.0
    ):
        raise PlantError(
            f"plant.icr_offset_m: {robot.icr_offset_m:g} m must be below half the wheelbase, "
            f"{robot.wheelbase_m / 2.0:g} m."
        )


def _check_terms(robot: RobotParameters) -> None:
    """Refuse unknown terms, and those that have no meaning for the robot's wheels."""
    given = complete(robot.terms)
    if robot.is_mecanum and robot.wheelbase_m is None:
        raise PlantError(
            "plant.wheelbase_m: a mecanum robot has four wheels; give their distance."
        )
    if robot.is_mecanum and robot.icr_offset_m != 0.0:
        raise PlantError(
            "plant.icr_offset_m: mecanum wheels turn about their centre; leave it out."
        )
    if robot.is_mecanum and robot.rotation_gain in ROTATION_GAINS:
        raise PlantError(
            f"kinematics.rotation_gain: {robot.rotation_gain} was measured with scrubbing wheels; "
            "leave it out for 1/(l_x + l_y), or give a number."
        )
    reasons = robot.meaningless
    for name, value in given.items():
        cause = TERMS[name].cause
        if cause in reasons and not TERMS[name].shape and value != TERMS[name].null:
            raise PlantError(f"plant.terms.{name}: {reasons[cause]}; leave it out.")


def _check_loop(robot: RobotParameters) -> None:
    loop, period_s = robot.loop, robot.period_s
    where = f"plant.slice: slice {robot.slice_name!r} has {period_s * 1e3:g} ms"
    if loop.k_d > 0.0 and loop.k_p == 0.0:
        raise PlantError(
            "plant.controller.k_p: must be above 0 when k_d is, for the derivative's filter."
        )
    if loop.euler and period_s >= 2.0 * loop.t2_s:
        raise PlantError(
            f"{where}, but discretization euler needs less than 2 T2 = {loop.t2_s * 2e3:g} ms: "
            "choose a shorter period or discretization exact."
        )
    if not loop.is_stable(period_s):
        limit_s = loop.largest_period_s(period_s)
        remedy = "choose a shorter period or smaller controller gains"
        if limit_s < 1e-6:
            remedy = (
                "no period is stable with these controller gains; choose smaller ones"
            )
        raise PlantError(
            f"{where}, but the wheel speed loop is unstable from {limit_s * 1e3:.1f} ms on: "
            f"{remedy}."
        )
