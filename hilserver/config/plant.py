"""The sections `plant:`, `kinematics:` and `sensors:` of the configuration.

Their models check form and range; what only the whole can tell (a slice too long for the wheel
loop) `RobotParameters` refuses with one sentence.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field, field_validator, model_validator

from hilserver.config.hall import load_hall
from hilserver.config.section import Section
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

    k_p: float = Field(13.513, ge=0, le=1e6, description="proportional gain [% duty per rpm]")
    k_i: float = Field(195.84, ge=0, le=1e9, description="integral gain [% duty per rpm and s]")
    k_d: float = Field(0.0, ge=0, le=1e6, description="derivative gain [% duty s per rpm]")
    derivative_n: float = Field(
        10.0, gt=0, le=1e6, description="derivative filter: tau = k_d / (derivative_n k_p)"
    )
    limit_pct: float = Field(100.0, gt=0, le=1000, description="limit of the duty, both signs [%]")


class ProcessConfig(Section):
    """Motor, gear and wheel: gain / ((t1 s + 1)(t2 s + 1))."""

    gain: float = Field(1.11, gt=0, le=1e4, description="speed per duty [rpm/%]")
    t1_s: float = Field(0.069, gt=0, le=100, description="slow time constant")
    t2_s: float = Field(0.0023, gt=0, le=100, description="fast time constant")


class PlantConfig(Section):
    """The robot's drive and body."""

    slice: str = Field("plant", description="slice in which the plant runs")
    drive: Literal["skid", "mecanum"] = Field(
        "skid",
        description="skid, or mecanum (rollers in X pattern; r 0.05, l_x 0.25, l_y 0.36)",
    )
    wheel_radius_m: float = Field(0.085, ge=0.001, le=10, description="wheel radius r")
    wheelbase_m: float | None = Field(
        0.25, ge=0.001, le=100, description="l_x, between front and rear wheels; null: two wheels"
    )
    track_m: float = Field(0.31, ge=0.001, le=100, description="l_y, between left and right wheels")
    icr_offset_m: float = Field(
        0.02, ge=-10, le=10, description="X_ICR from the centre of mass, below half the wheelbase"
    )
    max_rpm: float = Field(
        90.0, gt=0, le=10000, description="largest set-point; all wheels are scaled together"
    )
    controller: ControllerConfig = Field(default_factory=ControllerConfig)
    process: ProcessConfig = Field(default_factory=ProcessConfig)
    discretization: Literal["exact", "euler"] = Field(
        "exact", description="exact joint solution, or forward differences"
    )
    safe_ramp_s: float = Field(
        0.5, ge=0, le=60, description="time in which the safe state ramps the set-points to zero"
    )
    exclusive_twist: bool = Field(
        default=False, description="a twist with both parts drives only the larger one (5.4)"
    )
    seed: int = Field(0, ge=0, lt=2**53, description="seed of all noise")
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

    yaw_sign: Literal[-1, 1] = Field(-1, description="-1: right-handed; 1: as the thesis prints it")
    rotation_gain: str | float = Field(
        "geometric_skid",
        description="K_om [1/m], or one of " + ", ".join((*GEOMETRIC_GAINS, *ROTATION_GAINS)),
    )

    @field_validator("rotation_gain", mode="before")
    @classmethod
    def _number_or_name(cls, value: object) -> object:
        if not isinstance(value, str | int | float) or value != value:  # noqa: PLR0124 (NaN)
            raise ValueError(f"{value!r:.60} is not valid; it should be a number or a name")
        return value

    @field_validator("rotation_gain")
    @classmethod
    def _known_gain(cls, value: str | float) -> str | float:
        RobotParameters(rotation_gain=value)
        return value


Slice = Annotated[str, Field(description="slice in which it runs")]


class ImuConfig(Section):
    """Inertial unit."""

    enabled: bool = Field(
        default=True, description="false: its outputs have the status BadOutOfService"
    )
    slice: Slice = "sensors"
    gyro_noise_rad_s: float = Field(0.0, ge=0, le=10, description="white noise, sd")
    accel_noise_m_s2: float = Field(0.0, ge=0, le=100, description="white noise, sd")


class BatteryConfig(Section):
    """NiMH battery 19.2 V."""

    enabled: bool = Field(
        default=True, description="false: its output has the status BadOutOfService"
    )
    slice: Slice = "sensors"
    capacity_ah: float = Field(3.0, gt=0, le=1000, description="charge of the full pack")
    initial_charge: float = Field(0.9, ge=0, le=1, description="1 full, 0 empty")
    resistance_ohm: float = Field(0.15, ge=0, le=10, description="internal resistance")
    idle_current_a: float = Field(0.8, ge=0, le=100, description="current of the electronics")
    full_duty_current_a: float = Field(
        1.5, ge=0, le=100, description="current of one wheel at full duty"
    )


class TofConfig(Section):
    """Range finders at the corners."""

    enabled: bool = Field(
        default=True, description="false: their outputs have the status BadOutOfService"
    )
    slice: Slice = "sensors"
    hall: str = Field(
        "default", description="default, or a YAML file with walls: [[x1, y1, x2, y2], ...] in m"
    )
    mount_x_m: float = Field(0.20, gt=0, le=10, description="front sensors +x, rear ones -x")
    mount_y_m: float = Field(0.12, gt=0, le=10, description="left sensors +y, right ones -y")
    field_of_view_rad: float = Field(0.1745, gt=0, lt=3.14, description="whole angle of the cone")


class NavConfig(Section):
    """Navigation tag."""

    enabled: bool = Field(
        default=False, description="false: its outputs have the status BadOutOfService"
    )
    slice: Slice = "sensors"
    rate_hz: float = Field(
        20.0,
        gt=0,
        le=10000,
        description="sampling rate; its period must be a multiple of the slice",
    )
    lever_arm_x_m: float = Field(0.0, ge=-5, le=5, description="tag in front of the centre of mass")
    lever_arm_y_m: float = Field(0.0, ge=-5, le=5, description="tag left of the centre of mass")
    latency_s: float = Field(0.0, ge=0, le=100, description="age of the position")
    yaw_latency_s: float = Field(0.0, ge=0, le=100, description="age of the yaw")
    white_noise_m: float = Field(0.01, ge=0, le=10, description="white position noise, sd")
    correlated_noise_m: float = Field(0.08, ge=0, le=10, description="correlated noise, sd")
    correlation_s: float = Field(0.6, gt=0, le=1000, description="correlation time, position")
    yaw_noise_rad: float = Field(0.0175, ge=0, le=3, description="correlated yaw noise, sd")
    yaw_correlation_s: float = Field(2.0, gt=0, le=1000, description="correlation time, yaw")


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

    Parameters
    ----------
    plant, kinematics, sensors : models
        The sections.
    periods : mapping of str to float
        Period of every slice [s], by name.
    folder : Path, optional
        Folder of the configuration file, where the hall's path starts; the working directory.

    Raises
    ------
    PlantError
        When a slice is unknown or the robot cannot run with these values.
    """

    def period_s(key: str, name: str) -> float:
        if name not in periods:
            known = ", ".join(periods)
            msg = f"{key}: there is no slice {name!r}; the slices are {known}."
            raise PlantError(msg)
        return periods[name]

    def part(key: str, section: Any, **dropped: Any) -> dict[str, Any]:
        values: dict[str, Any] = section.model_dump(exclude={"slice", *dropped})
        return {**values, "period_s": period_s(f"sensors.{key}.slice", section.slice)}

    values = plant.model_dump(exclude={"slice", "controller", "process"})
    hall = load_hall(sensors.tof.hall, folder or Path())
    robot = RobotParameters(
        **values,
        **kinematics.model_dump(),
        period_s=period_s("plant.slice", plant.slice),
        slice_name=plant.slice,
        controller=parts.Controller(**plant.controller.model_dump()),
        process=parts.Process(**plant.process.model_dump()),
        imu=parts.Imu(**part("imu", sensors.imu)),
        battery=parts.Battery(**part("battery", sensors.battery)),
        tof=parts.RangeFinders(**part("tof", sensors.tof, hall=None)),
        nav=parts.Navigation(**part("nav", sensors.nav)),
        hall=hall.walls,
        solids=hall.solids,
    )
    pack(robot)  # refuses terms that do not fit the robot
    return robot
