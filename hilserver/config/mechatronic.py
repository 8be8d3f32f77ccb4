"""The section ``mechatronic``: a robot of bodies beside the planar plant."""

from typing import Literal, Self

from pydantic import Field, model_validator

from hilserver.body.parameters import BodyParameters, Tyre
from hilserver.config.section import Section, of
from hilserver.plant.parameters import RobotParameters

DEFAULT_SLICE = "mechatronic"
BODY_PERIOD_MS = 2.0


class TyreConfig(Section):
    """Friction between wheels and floor."""

    mu_long: float = of(Tyre, "mu_long")
    mu_lat: float = of(Tyre, "mu_lat")
    v0_m_s: float = of(Tyre, "v0_m_s")
    rolling: float = of(Tyre, "rolling")


class MechatronicConfig(Section):
    """The robot as a body on four wheels in a hall (MuJoCo; extra `physics`)."""

    enabled: bool = Field(default=False, description="true: needs the extra physics")
    slice: str = Field(
        DEFAULT_SLICE,
        description=f"slice in which it runs; {DEFAULT_SLICE} has {BODY_PERIOD_MS:g} ms unless"
        " scheduler.slices says otherwise",
    )
    step_ms: float = Field(
        1.0, gt=0, le=100, description="step; the slice is a multiple of it"
    )
    driven_by: Literal["speed", "torque"] = Field(
        "speed",
        description="speed: the plant's wheel speeds; torque: the wheels turn as the floor allows",
    )
    sensors: Literal["planar", "body"] = Field(
        "planar", description="source of tof.*, imu.* and nav.*; torque needs body"
    )
    stall_torque_nm: float = of(BodyParameters, "stall_torque_nm")
    mass_kg: float = of(BodyParameters, "mass_kg")
    inertia_kg_m2: tuple[float, float, float] | None = Field(
        None,
        description="moments about the centre of mass; null: a box as large as the chassis",
    )
    centre_of_mass_m: tuple[float, float, float] = Field(
        (0.0, 0.0, 0.06),
        description="ahead and to the left of the wheels' centre, and above the floor",
    )
    tyre: TyreConfig = TyreConfig()
    air_n_s2_m2: float = of(BodyParameters, "air_n_s2_m2")

    @model_validator(mode="after")
    def _torque_has_sensors(self) -> Self:
        if self.turns_wheels and self.sensors != "body":
            raise ValueError(
                "driven_by: torque needs sensors: body, or the two would contradict"
            )
        return self

    @property
    def turns_wheels(self) -> bool:
        """Whether the body, not the plant's process, turns the wheels."""
        return self.enabled and self.driven_by == "torque"

    def body(self, robot: RobotParameters, slice_s: float) -> BodyParameters:
        """Return the body that the section describes.

        PlantError when it cannot stand or step with these values.
        """
        return BodyParameters(
            robot=robot,
            slice_s=slice_s,
            step_s=self.step_ms * 1e-3,
            torque=self.turns_wheels,
            sensors=self.sensors == "body",
            stall_torque_nm=self.stall_torque_nm,
            mass_kg=self.mass_kg,
            centre_of_mass_m=self.centre_of_mass_m,
            inertia_kg_m2=self.inertia_kg_m2,
            air_n_s2_m2=self.air_n_s2_m2,
            tyre=Tyre(**self.tyre.model_dump()),
        )
