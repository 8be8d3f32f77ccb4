"""The geometry of a drive as other programs see it, and what a patch changes in it.

Speeds of the wheels over the floor are l and r, forward positive. The plant has
v = (l + r)/2 times its traction and om = K (r - l); a controller of others has v = (l + r)/2 and
om = (r - l)/separation. So traction scales both radii, and the separation is traction/K.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final, Self

from hilserver.parameters import with_values
from hilserver.parameters.table import TERM
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters

HELD: Final = frozenset(
    {"wheel_radius", "wheel_radius_difference", "rotation_gain", "traction_slip"}
)
"""Causes that are nothing but other wheel radii or another separation of the wheels."""


@dataclass(frozen=True, slots=True)
class DriveGeometry:
    """Wheel radii and separation with which v and om follow from the wheels, all in m."""

    left_m: float
    right_m: float
    separation_m: float

    @classmethod
    def of(cls, robot: RobotParameters) -> Self:
        """Return the geometry of a robot, with the terms that it has."""
        p = pack(robot)
        traction = float(p.traction)
        left_m = float(p.radius_left) * traction
        right_m = float(p.radius_right) * traction
        separation_m = traction / abs(float(p.yaw_gain))
        return cls(left_m, right_m, separation_m)

    @property
    def radius_m(self) -> float:
        """Mean of both radii."""
        return (self.left_m + self.right_m) / 2.0


def patched(robot: RobotParameters, terms: Mapping[str, float]) -> RobotParameters:
    """Return the robot with the terms of a patch."""
    values = {f"{TERM}{name}": value for name, value in terms.items()}
    return with_values(robot, values)


def for_simulator(
    base: DriveGeometry, true: DriveGeometry
) -> tuple[DriveGeometry, float]:
    """Return what a controller needs to move a simulated base as the true one moves.

    The true robot's controller knows the geometry `base`, and so does the simulated robot: its
    wheels roll as `base` says. Only the controller in the simulator is another one. It has three
    numbers for the four that turn (v, om) into two wheel speeds, so for unequal radii together
    with another separation a gap remains: the second value, in shares of the turn rate.
    """
    left = true.left_m / base.left_m
    right = true.right_m / base.right_m
    turn = base.separation_m / true.separation_m

    # speed of each side over the simulated floor, per commanded v and per om separation/2
    left_v = (left * (1.0 + turn) + right * (1.0 - turn)) / 2.0
    right_v = (right * (1.0 + turn) + left * (1.0 - turn)) / 2.0
    left_turn = (left * (1.0 + turn) - right * (1.0 - turn)) / 2.0
    right_turn = (right * (1.0 + turn) - left * (1.0 - turn)) / 2.0

    of_left = left_turn / left_v
    of_right = right_turn / right_v
    factor = (of_left + of_right) / 2.0
    # one side turns the body a little more than it should, the other a little less
    gap = abs(of_left - of_right) / 2.0
    left_m = base.left_m / left_v
    right_m = base.right_m / right_v
    separation_m = base.separation_m * factor
    geometry = DriveGeometry(left_m, right_m, separation_m)
    return geometry, gap
