"""The mechatronic model's parameters: checked physical values, packed for the kernel."""

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from hilserver.body.layout import Constants
from hilserver.plant.errors import PlantError
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.quantity import quantity, refused
from hilserver.plant.terms import complete
from hilserver.plant.units import RPM_PER_RAD_S

GRAVITY_M_S2 = 9.81
# EduArt's chassis with its superstructure: length, width, height
PLATES_M = (0.38, 0.22, 0.10)
WHEEL_WIDTH_M = 0.055
# how far the bumper is in front of the wheels, which never touch a wall
BUMPER_GAP_M = 0.01
_GRIP_ANGLE = (-1.0, 1.0, 1.0, -1.0)
"""Mecanum wheels fl, rl, fr, rr grip along this times 45 degrees from their plane: an X."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Tyre:
    """Friction along and across the wheels, the slip below which it fades, rolling resistance."""

    mu_long: float = quantity(0.8, "friction along the wheels", gt=0, le=10)
    mu_lat: float = quantity(
        0.8, "friction across the wheels; not used with mecanum", gt=0, le=10
    )
    v0_m_s: float = quantity(
        0.03, "slip below which friction fades; 0.03 is stable at 1 ms", gt=0, le=1
    )
    rolling: float = quantity(0.01, "rolling resistance per normal force", ge=0, le=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class BodyParameters:
    """Parameters of MuJoCo's model and of the kernel of wheels and tyres.

    PlantError if a value is not finite, out of range, or the step is too long for the tyre.
    """

    robot: RobotParameters  # geometry, process and range finders
    # period of the time slice, and of the steps into which it is split
    slice_s: float = quantity(0.002, "period of its slice", jumps="fixed", gt=0)
    step_s: float = quantity(0.001, "step", jumps="fixed", gt=0)
    # driven by the drives' torque instead of the plant's wheel speeds
    torque: bool = False
    sensors: bool = False  # whether imu.* and tof.* come from here
    stall_torque_nm: float = quantity(
        2.0, "torque of a drive at full duty and standstill", gt=0, le=1e4
    )
    mass_kg: float = quantity(5.0, "mass of the whole robot", gt=0, le=1e5)
    # in front of and left of the wheels' centre, and above the floor
    centre_of_mass_m: tuple[float, float, float] = (0.0, 0.0, 0.06)
    # about the centre of mass; None: as of a box of the chassis' size
    inertia_kg_m2: tuple[float, float, float] | None = None
    # drag at 1 m/s
    air_n_s2_m2: float = quantity(0.03, "air drag at 1 m/s [N]", ge=0, le=1e3)
    tyre: Tyre = field(default_factory=Tyre)

    def __post_init__(self) -> None:
        for part, path in ((self, ""), (self.tyre, "tyre.")):
            for name, value, wanted in refused(part):
                raise PlantError(f"mechatronic.{path}{name}: {wanted}, not {value:g}.")
        for number, moment in enumerate(self.inertia_kg_m2 or ()):
            if not 0.0 < moment < math.inf:
                text = f"inertia_kg_m2.{number}: must be above 0, not {moment:g}."
                raise PlantError(f"mechatronic.{text}")
        _check_geometry(self)
        _check_steps(self)

    @property
    def steps(self) -> int:
        """Steps per slice."""
        return round(self.slice_s / self.step_s)

    @property
    def wheel_inertia_kg_m2(self) -> float:
        """Inertia of a wheel with its drive; lifted, the wheel has the slow lag of (5.23)."""
        lag_s = self.robot.process.t1_s * (1.0 + self._term("time_constant"))
        return self.stall_torque_nm * lag_s / self.no_load_rad_s

    @property
    def no_load_rad_s(self) -> float:
        """Speed of a lifted wheel at full duty."""
        gain = self.robot.process.gain * (1.0 + self._term("process_gain"))
        return 100.0 * gain / RPM_PER_RAD_S

    def _term(self, name: str) -> float:
        return complete(self.robot.terms)[name] or 0.0

    @property
    def wheels_m(self) -> NDArray[np.float64]:
        """Centres of the wheels fl, rl, fr, rr from the centre of mass, shape (4, 3)."""
        along = 0.5 * (self.robot.wheelbase_m or 0.0) * np.array([1.0, -1.0, 1.0, -1.0])
        aside = 0.5 * self.robot.track_m * np.array([1.0, 1.0, -1.0, -1.0])
        up = np.full(4, self.robot.wheel_radius_m)
        centres: NDArray[np.float64] = np.stack([along, aside, up], axis=1)
        centres -= self.centre_of_mass_m
        return centres

    @property
    def chassis_m(self) -> tuple[float, float, float]:
        """Length, width and height of the chassis; it lies at the height of the wheels' centres."""
        if self.robot.wheelbase_m is not None:
            return PLATES_M
        # nothing states its size: one that fits between two wheels, as round as most
        return self.robot.track_m, self.robot.track_m / 2, self.robot.wheel_radius_m

    @property
    def moments_kg_m2(self) -> tuple[float, float, float]:
        """Moments of inertia about the centre of mass."""
        if self.inertia_kg_m2 is not None:
            return self.inertia_kg_m2
        x, y, z = (size * size / 12.0 * self.mass_kg for size in self.chassis_m)
        return y + z, x + z, x + y

    def pack(self) -> Constants:
        """Return the parameters as the kernel reads them."""
        robot, process, p = self.robot, self.robot.process, Constants.zeros()
        p.dt = self.step_s
        p.steps = self.steps
        p.ticks = round(self.slice_s / robot.period_s)
        p.torque = self.torque
        p.radius = robot.wheel_radius_m
        p.inertia = self.wheel_inertia_kg_m2
        lag_s = self.wheel_inertia_kg_m2 * self.no_load_rad_s / self.stall_torque_nm
        p.rate = -math.expm1(-self.step_s / lag_s) / self.step_s
        p.speed_per_duty = self.no_load_rad_s / 100.0
        p.duty_keep = math.exp(-self.step_s / process.t2_s)
        p.grip = self.tyre.mu_long
        p.ratio = 0.0 if robot.is_mecanum else self.tyre.mu_lat / self.tyre.mu_long
        p.v0 = self.tyre.v0_m_s
        p.rolling = self.tyre.rolling
        p.air = self.air_n_s2_m2
        p.rest_height = self.centre_of_mass_m[2]
        angle = 0.25 * math.pi * np.array(_GRIP_ANGLE) * robot.is_mecanum
        p.cos[:], p.sin[:] = np.cos(angle), np.sin(angle)
        return p


def _check_geometry(body: BodyParameters) -> None:
    robot, (ahead, aside, height) = body.robot, body.centre_of_mass_m
    # a robot on one axle stands on its castors, too
    length_m = robot.track_m if robot.wheelbase_m is None else robot.wheelbase_m
    inside = abs(ahead) < length_m / 2 and abs(aside) < robot.track_m / 2 and height > 0
    if not inside:
        raise PlantError(
            f"mechatronic.centre_of_mass_m: {list(body.centre_of_mass_m)} must lie between the"
            " wheels and above the floor, or the robot falls over."
        )
    moments = sorted(body.moments_kg_m2)
    if moments[0] + moments[1] < moments[2] * (1.0 - 1e-9):
        raise PlantError(
            f"mechatronic.inertia_kg_m2: {list(moments)} is not possible for a body: no moment may"
            f" exceed the sum of the others."
        )


def _check_steps(body: BodyParameters) -> None:
    for key, whole, part in (
        ("step_ms", body.slice_s, body.step_s),
        ("slice", body.slice_s, body.robot.period_s),
    ):
        if abs(whole / part - round(whole / part)) > 1e-6 or round(whole / part) < 1:
            what = "step_ms" if key == "step_ms" else "the plant's slice"
            raise PlantError(
                f"mechatronic.{key}: the slice of {whole * 1e3:g} ms must be a multiple of {what},"
                f" {part * 1e3:g} ms."
            )
    longest_s = _longest_step_s(body)
    if body.step_s > longest_s:
        v0 = body.tyre.v0_m_s * body.step_s / longest_s
        raise PlantError(
            f"mechatronic.step_ms: {body.step_s * 1e3:g} ms is too long for this tyre: use at most"
            f" {longest_s * 1e3:.2g} ms, or tyre.v0_m_s of at least {v0:.2g} m/s."
        )


def _longest_step_s(body: BodyParameters) -> float:
    """Return the step at which the tyre's damping begins to overshoot.

    At zero slip a tyre is a damper of ``mu N / v0``. All tyres together brake the body's motion and
    turning, and each its own wheel; explicit steps overshoot above 1/rate, diverge above 2/rate.
    """
    damping = max(body.tyre.mu_long, body.tyre.mu_lat) * GRAVITY_M_S2 * body.mass_kg
    damping /= body.tyre.v0_m_s
    arm_2 = float(np.mean(np.sum(body.wheels_m[:, :2] ** 2, axis=1)))
    rates = [damping / body.mass_kg, damping * arm_2 / body.moments_kg_m2[2]]
    if body.torque:
        rates.append(
            0.25 * damping * body.robot.wheel_radius_m**2 / body.wheel_inertia_kg_m2
        )
    return 1.5 / max(rates)
