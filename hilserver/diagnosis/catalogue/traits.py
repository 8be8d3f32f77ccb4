"""Traits of causes on which rules depend, one row per cause that has any.

A rule asks for a trait, never for a name, so a cause that is added with its row takes part.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import MappingProxyType
from typing import Final


class Need(StrEnum):
    """What a log may lack, as the findings say it; if several are missing, the last one counts."""

    SPEED = "no wheel speed in the log"
    DUTY = "no duty in the log"
    VOLTAGE = "no battery voltage in the log"
    POSITION = "no position in the log"
    PLACE = "the navigation frame changes with every segment"
    STEADY = "the error of the reference lasts: it looks like an effect of the place"
    YAW = "no navigation yaw in the log"
    GYRO = "no turn rate in the log"
    STAMPS = "the log has no time stamps"


@dataclass(frozen=True, slots=True, kw_only=True)
class Traits:
    """What rules need to know about a cause."""

    # what a log must hold for the cause to be judged; all causes of the drive need wheel speeds
    needs: tuple[Need, ...] = ()
    not_judged: str = ""  # why it has no candidate
    # share of its size by which its form may be off, because it is decided anew at every step:
    # whether a wheel sticks, how the loop responds; measured against a machine in continuous time
    # (``hilserver bench diagnose --class single``)
    abrupt: float = 0.0
    whole_ticks: bool = False  # a time that acts in whole ticks of the plant
    adds_up: bool = False  # a period: the smallest error of it adds up along the log
    # it has no finite null: a smaller parameter has a larger effect
    is_limit: bool = False
    at_rest: bool = False  # it is visible on a robot that stands still
    # changes along the log may look like it: the robot is at other places early than late
    of_a_place: bool = False
    # it makes a turn late, or its gain depend on the turn, as scrubbing tyres do
    delays_turn: bool = False
    bends_turn: bool = False
    # parameter of friction across the wheels with the same effect on turns
    scrubs_as: str = ""
    # cause of the same size and opposite sign that one floor cannot tell from it
    mirrored_by: str = ""
    # parameter of the place-dependent errors of which it is the simplest
    field: str = ""
    # causes that it may stand for if both act: swapping single causes does not lead from it to
    # them
    together: tuple[str, ...] = ()
    # causes that together do on the whole floor what it does on a part: both at once look like a
    # part that holds nearly all of the drive, and swapping single causes does not lead to them
    everywhere: tuple[str, ...] = ()
    # if found in an input, the log does not show when that changed
    hides_inputs: bool = False


POSITION_FIELD: Final = "nav_position_bias.amplitude"

TRAITS: Final[Mapping[str, Traits]] = MappingProxyType({
    "coulomb_friction": Traits(abrupt=0.02),
    # other loads are visible without duty if they keep wheels from their set-points
    "dead_zone": Traits(needs=(Need.DUTY,)),
    "stribeck_friction": Traits(needs=(Need.DUTY,), abrupt=0.02),
    "wheel_load": Traits(abrupt=0.02),
    "battery_sag": Traits(needs=(Need.VOLTAGE,), abrupt=0.015),
    "actuation_delay": Traits(needs=(Need.STAMPS,), whole_ticks=True),
    "setpoint_rate_limit": Traits(is_limit=True),
    "control_period": Traits(needs=(Need.STAMPS,), whole_ticks=True, adds_up=True),
    "controller_gains": Traits(abrupt=0.01),
    "encoder_scale": Traits(needs=(Need.DUTY,)),
    "encoder_filter": Traits(whole_ticks=True),
    "backlash": Traits(not_judged="backlash between motor and wheel is not tested"),
    "rotation_gain": Traits(scrubs_as="friction_anisotropy.ratio"),
    "rotation_gain_speed": Traits(bends_turn=True),
    "rotation_gain_radius": Traits(bends_turn=True),
    "longitudinal_slip": Traits(needs=(Need.POSITION,)),
    "acceleration_slip": Traits(needs=(Need.POSITION,)),
    # rollers separate it from a scale of the navigation; tyres on one floor do not
    "traction_slip": Traits(
        needs=(Need.POSITION,), not_judged="on a single floor it has the same effect as nav_scale"
    ),
    "roller_slip": Traits(needs=(Need.POSITION,)),
    "body_lag": Traits(delays_turn=True),
    "side_slip": Traits(needs=(Need.POSITION,)),
    "icr_offset": Traits(needs=(Need.POSITION,)),
    "wheel_misalignment": Traits(needs=(Need.POSITION,)),
    "floor_slope": Traits(needs=(Need.POSITION, Need.PLACE, Need.STEADY)),
    "surface_change": Traits(
        needs=(Need.POSITION, Need.PLACE, Need.STEADY),
        of_a_place=True,
        everywhere=("rotation_gain", "nav_scale"),
    ),
    "friction_anisotropy": Traits(
        not_judged="in steady turns it has the same effect as rotation_gain and icr_offset"
    ),
    "nav_frame_yaw": Traits(needs=(Need.POSITION, Need.YAW)),
    "nav_lever_arm": Traits(needs=(Need.POSITION,)),
    # In a bend a late position lies where side slip would put it. If the whole source is late
    # and the robot slips, the latency of the position alone explains part of both.
    "nav_latency": Traits(
        needs=(Need.POSITION, Need.STAMPS),
        whole_ticks=True,
        together=("clock_offset", "side_slip"),
    ),
    "yaw_latency": Traits(needs=(Need.YAW, Need.STAMPS), whole_ticks=True, delays_turn=True),
    "nav_scale": Traits(
        needs=(Need.POSITION,), mirrored_by="traction_slip", field=POSITION_FIELD
    ),
    "nav_position_bias": Traits(needs=(Need.POSITION, Need.PLACE, Need.STEADY)),
    "nav_outliers": Traits(needs=(Need.POSITION,)),
    "heading_distortion": Traits(needs=(Need.PLACE, Need.YAW)),
    "gyro_bias": Traits(needs=(Need.GYRO,), at_rest=True),
    "gyro_scale": Traits(needs=(Need.GYRO,)),
    "imu_latency": Traits(needs=(Need.GYRO, Need.STAMPS), whole_ticks=True, delays_turn=True),
    "clock_offset": Traits(needs=(Need.STAMPS,), whole_ticks=True, delays_turn=True),
    "held_samples": Traits(hides_inputs=True),
    "interpolated_setpoint": Traits(hides_inputs=True),
    "missed_ticks": Traits(not_judged="the log has no tick counter"),
})  # fmt: skip

NONE: Final = Traits()


def traits_of(cause: str) -> Traits:
    """Return the traits of a cause; a cause without a row has none."""
    return TRAITS.get(cause, NONE)


def lacking(missing: Iterable[Need], drive: Iterable[str]) -> dict[str, str]:
    """Return, by cause, why it cannot be judged if something is missing.

    Parameters
    ----------
    drive : iterable of str
        Causes that need wheel speeds.
    """
    reasons: dict[str, str] = {}
    for need in sorted(missing, key=list(Need).index):
        if need is Need.SPEED:
            reasons |= dict.fromkeys(drive, need.value)
        reasons |= {
            cause: need.value for cause, own in TRAITS.items() if need in own.needs
        }
    return reasons
