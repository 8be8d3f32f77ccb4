"""The section ``shadow:``: the simulation runs beside the real robot."""

from typing import Annotated

from pydantic import Field

from hilserver.config.section import Section


class ShadowConfig(Section):
    """When the gap between the measured and the simulated robot is an alarm."""

    limits: dict[str, Annotated[float, Field(gt=0)]] = Field(
        default_factory=dict,
        description="largest gap by signal, in its unit, such as pose.x_m: 0.3; empty: no alarm",
    )
    after_s: float = Field(1.0, ge=0, le=3600, description="a gap that lasts this long is an alarm")
