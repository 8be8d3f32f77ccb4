"""How the effect of a scenario is looked at: in which quantity, over which stretch."""

from collections.abc import Mapping
from typing import Final

from hilserver.measured.channels import GYRO, NAV_X, SPEEDS, YAW
from reference.scenarios.views.case import Case, View
from reference.scenarios.views.over_time import AsRecorded, OverTime
from reference.scenarios.views.summaries import (
    AgainstHeading,
    DutyOverSpeed,
    OverHorizon,
    TurnGains,
)
from reference.scenarios.views.way import Way

__all__ = ["VIEWS", "Case"]

VIEWS: Final[Mapping[str, View]] = {
    "friction_load": OverTime(SPEEDS[0], "speed, front left", 20.0, with_setpoint=True),
    "k_omega_low": OverTime(GYRO, "turn rate", 25.0),
    "surface_null": TurnGains(("floors A", "floors B"), with_model=False),
    "surface_real": TurnGains(("concrete", "tile")),
    "unsteady_bias": OverTime(GYRO, "turn rate", 3.0),
    "pulls_aside": OverTime(YAW, "heading", 30.0),
    "slides_in_circle": Way(),
    "launch_slip": OverTime(NAV_X, "position x", 30.0),
    "fast_input": AsRecorded(SPEEDS[0], "speed, front left", "rpm", 5.0),
    "radio": OverTime(NAV_X, "position x", 30.0),
    "small_deviation": OverHorizon("yaw_rad", "error in heading", "rad"),
    "fused_yaw": AgainstHeading(),
    "on_a_frame": DutyOverSpeed(),
    "rates": AsRecorded(SPEEDS[0], "speed, front left", "rpm", 1.5, at_rows=True),
    "interpolated": AsRecorded(
        SPEEDS[0], "speed, front left", "rpm", 1.5, at_rows=True
    ),
    "signs_units": AsRecorded(GYRO, "turn rate", "rad/s", 20.0),
    "slow_slice": OverTime(SPEEDS[0], "speed, front left", 0.5, with_setpoint=True),
}
"""Of every scenario the quantity in which it shows."""
