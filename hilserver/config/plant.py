"""The sections `plant:`, `kinematics:` and `sensors:` of the configuration.

The models check form and range. Errors that concern the whole (a slice too long for the wheel
loop) are refused by `RobotParameters` with one sentence.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from hilserver.config.hall import load_hall
from hilserver.config.section import Section, of
from hilserver.plant import parts
from hilserver.plant.errors import PlantError
from hilserver.plant.packing import pack
from hilserver.plant.parameters import (
    GEOMETRIC_GAINS,
    MECANUM_GEOMETRY,
    ROTATION_GAINS,
    RobotParameters,
)
from hilserver.plant.terms import complete


class ControllerConfig(Section):
    """Wheel speed controller: PI(D) in parallel form with back-calculation."""

    k_p: float = of(parts.Controller, "k_p")
    k_i: float = of(parts.Controller, "k_i")
    k_d: float = of(parts.Controller, "k_d")
    derivative_n: float = of(parts.Controller, "derivative_n")
    limit_pct: float = of(parts.Controller, "limit_pct")


class ProcessConfig(Section):
    """Motor, gear and wheel: gain / ((t1 s + 1)(t2 s + 1))."""

    gain: float = of(parts.Process, "gain")
    t1_s: float = of(parts.Process, "t1_s")
    t2_s: float = of(parts.Process, "t2_s")


class PlantConfig(Section):
    """The robot's drive and body."""

    slice: str = Field("plant", description="slice in which the plant runs")
    drive: Literal["skid", "mecanum"] = Field(
        "skid",
        description="skid, or mecanum (rollers in X pattern; r 0.05, l_x 0.25, l_y 0.36)",
    )
    wheel_radius_m: float = of(RobotParameters, "wheel_radius_m")
    wheelbase_m: float | None = of(RobotParameters, "wheelbase_m")
    track_m: float = of(RobotParameters, "track_m")
    icr_offset_m: float = of(RobotParameters, "icr_offset_m")
    max_rpm: float = of(RobotParameters, "max_rpm")
    controller: ControllerConfig = Field(default_factory=ControllerConfig)
    process: ProcessConfig = Field(default_factory=ProcessConfig)
    discretization: Literal["exact", "euler"] = Field(
        "exact", description="exact joint solution, or forward differences"
    )
    safe_ramp_s: float = of(RobotParameters, "safe_ramp_s")
    exclusive_twist: bool = Field(
        default=False,
        description="drive only the larger part of a twist with both (5.4)",
    )
    seed: int = of(RobotParameters, "seed")
    terms: dict[str, float | None] = Field(
        default_factory=dict, description="values by cause or cause.part; null: none"
    )

    @model_validator(mode="before")
    @classmethod
    def _geometry_of_the_drive(cls, value: object) -> object:
        if isinstance(value, dict) and value.get("drive") == "mecanum":
            return {**MECANUM_GEOMETRY, **value}
        return value

    @field_validator("terms")
    @classmethod
    def _known_terms(cls, value: dict[str, float | None]) -> dict[str, float | None]:
        complete(value)
        return value


class KinematicsConfig(Section):
    """Turn rate from wheel speeds: om = yaw_sign r K_om (w_L + w_R)."""

    yaw_sign: Literal[-1, 1] = Field(
        -1, description="-1: right-handed; 1: as the thesis prints it"
    )
    rotation_gain: str | float = Field(
        "geometric_skid",
        description="K_om [1/m], or one of "
        + ", ".join((*GEOMETRIC_GAINS, *ROTATION_GAINS)),
    )

    @field_validator("rotation_gain", mode="before")
    @classmethod
    def _number_or_name(cls, value: object) -> object:
        if not isinstance(value, str | int | float) or value != value:  # noqa: PLR0124 (NaN)
            raise ValueError(
                f"{value!r:.60} is not valid; it should be a number or a name"
            )
        return value

    @field_validator("rotation_gain")
    @classmethod
    def _known_gain(cls, value: str | float) -> str | float:
        RobotParameters(rotation_gain=value)
        return value


Slice = Annotated[str, Field(description="slice in which it runs")]


def _enabled(what_has: str, *, default: bool = True) -> Any:
    return Field(default, description=f"false: {what_has} the status BadOutOfService")


class ImuConfig(Section):
    """Inertial unit."""

    enabled: bool = _enabled("its outputs have")
    slice: Slice = "sensors"
    gyro_noise_rad_s: float = of(parts.Imu, "gyro_noise_rad_s")
    accel_noise_m_s2: float = of(parts.Imu, "accel_noise_m_s2")


class BatteryConfig(Section):
    """NiMH battery 19.2 V."""

    enabled: bool = _enabled("its output has")
    slice: Slice = "sensors"
    capacity_ah: float = of(parts.Battery, "capacity_ah")
    initial_charge: float = of(parts.Battery, "initial_charge")
    resistance_ohm: float = of(parts.Battery, "resistance_ohm")
    idle_current_a: float = of(parts.Battery, "idle_current_a")
    full_duty_current_a: float = of(parts.Battery, "full_duty_current_a")


class TofConfig(Section):
    """Range finders at the corners."""

    enabled: bool = _enabled("their outputs have")
    slice: Slice = "sensors"
    hall: str = Field(
        "default",
        description="default, or a YAML file with walls: [[x1, y1, x2, y2], ...] in m",
    )
    mount_x_m: float = of(parts.RangeFinders, "mount_x_m")
    mount_y_m: float = of(parts.RangeFinders, "mount_y_m")
    field_of_view_rad: float = of(parts.RangeFinders, "field_of_view_rad")


class NavConfig(Section):
    """Navigation tag."""

    enabled: bool = _enabled("its outputs have", default=False)
    slice: Slice = "sensors"
    rate_hz: float = of(parts.Navigation, "rate_hz")
    lever_arm_x_m: float = of(parts.Navigation, "lever_arm_x_m")
    lever_arm_y_m: float = of(parts.Navigation, "lever_arm_y_m")
    latency_s: float = of(parts.Navigation, "latency_s")
    yaw_latency_s: float = of(parts.Navigation, "yaw_latency_s")
    white_noise_m: float = of(parts.Navigation, "white_noise_m")
    correlated_noise_m: float = of(parts.Navigation, "correlated_noise_m")
    correlation_s: float = of(parts.Navigation, "correlation_s")
    yaw_noise_rad: float = of(parts.Navigation, "yaw_noise_rad")
    yaw_correlation_s: float = of(parts.Navigation, "yaw_correlation_s")


class SensorsConfig(Section):
    """All sensors."""

    imu: ImuConfig = Field(default_factory=ImuConfig)
    battery: BatteryConfig = Field(default_factory=BatteryConfig)
    tof: TofConfig = Field(default_factory=TofConfig)
    nav: NavConfig = Field(default_factory=NavConfig)


def to_parameters(
    plant: PlantConfig,
    kinematics: KinematicsConfig,
    sensors: SensorsConfig,
    periods: Mapping[str, float],
    folder: Path | None = None,
) -> RobotParameters:
    """Return the robot that the three sections describe.

    PlantError if a slice is unknown or the robot cannot run with these values.

    Parameters
    ----------
    plant, kinematics, sensors : models
        The sections.
    periods : mapping of str to float
        Period of every slice [s], by name.
    folder : Path, optional
        Folder of the configuration file, for the hall's path; by default the working directory.
    """

    def part(key: str) -> dict[str, Any]:
        section = getattr(sensors, key)
        values: dict[str, Any] = section.model_dump(exclude={"slice", "hall"})
        return {
            **values,
            "period_s": _period_s(periods, f"sensors.{key}.slice", section.slice),
        }

    values = plant.model_dump(exclude={"slice", "controller", "process"})
    hall = load_hall(sensors.tof.hall, folder or Path())
    robot = RobotParameters(
        **values,
        **kinematics.model_dump(),
        period_s=_period_s(periods, "plant.slice", plant.slice),
        slice_name=plant.slice,
        controller=parts.Controller(**plant.controller.model_dump()),
        process=parts.Process(**plant.process.model_dump()),
        imu=parts.Imu(**part("imu")),
        battery=parts.Battery(**part("battery")),
        tof=parts.RangeFinders(**part("tof")),
        nav=parts.Navigation(**part("nav")),
        hall=hall.walls,
        solids=hall.solids,
    )
    pack(robot)  # refuses terms that do not fit the robot
    return robot


def _period_s(periods: Mapping[str, float], key: str, name: str) -> float:
    if name not in periods:
        known = ", ".join(periods)
        raise PlantError(f"{key}: there is no slice {name!r}; the slices are {known}.")
    return periods[name]


def check_apart(robot: RobotParameters) -> None:
    """PlantError if front and rear wheels are in each other's place: as bodies they would jam."""
    diameter_m = 2.0 * robot.wheel_radius_m
    if robot.wheelbase_m is not None and robot.wheelbase_m < diameter_m:
        raise PlantError(
            f"plant.wheelbase_m: {robot.wheelbase_m:g} m is less than a wheel's diameter,"
            f" {diameter_m:g} m, so front and rear wheels would overlap: give the distance between"
            " the axles, or null for one axle"
        )
