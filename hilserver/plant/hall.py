"""The hall that the range finders see: walls as line segments."""

import math
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Solid:
    """A box in the hall that the mechatronic model can touch."""

    # centre in the world's frame, and half of length, width and height
    centre_m: tuple[float, float, float]
    half_m: tuple[float, float, float]
    # direction of its length, and its slope in this direction
    yaw_rad: float = 0.0
    pitch_rad: float = 0.0
    carries: bool = False  # wheels roll onto it; otherwise it blocks the chassis


DEFAULT_WALLS: Final = (
    (-3.0, -3.0, 5.0, -3.0),  # south
    (5.0, -3.0, 5.0, 0.8),  # east, up to the doorway
    (5.0, 1.8, 5.0, 3.0),  # east, beyond the doorway
    (5.0, 3.0, -3.0, 3.0),  # north
    (-3.0, 3.0, -3.0, -3.0),  # west
    (5.0, 0.8, 7.0, 0.8),  # corridor behind the doorway
    (5.0, 1.8, 7.0, 1.8),
    (2.8, 1.9, 3.2, 1.9),  # pillar, 0.4 m square
    (3.2, 1.9, 3.2, 2.3),
    (3.2, 2.3, 2.8, 2.3),
    (2.8, 2.3, 2.8, 1.9),
    (-2.2, -2.3, -1.8, -2.3),  # pillar
    (-1.8, -2.3, -1.8, -1.9),
    (-1.8, -1.9, -2.2, -1.9),
    (-2.2, -1.9, -2.2, -2.3),
    (0.0, -2.6, 2.0, -2.6),  # shelf along the south wall
    (0.0, -2.6, 0.0, -3.0),
    (2.0, -2.6, 2.0, -3.0),
)
"""x1, y1, x2, y2 [m] in the world frame; the robot starts in the origin and looks along x. A room
of 8 m by 6 m with two pillars, a shelf and a doorway."""


def default_hall() -> NDArray[np.float64]:
    """Return the walls of the default hall, shape (4 n,): x1, y1, x2, y2 [m] of each."""
    return np.array(DEFAULT_WALLS, dtype=np.float64).reshape(-1)


def wall_solids(
    segments: NDArray[np.float64], height_m: float = 1.0, thickness_m: float = 0.05
) -> tuple[Solid, ...]:
    """Return walls as boxes around their segments; `segments` as `default_hall` returns them."""
    solids = []
    for x1, y1, x2, y2 in segments.reshape(-1, 4).tolist():
        half = 0.5 * math.hypot(x2 - x1, y2 - y1) + 0.5 * thickness_m
        centre = (0.5 * (x1 + x2), 0.5 * (y1 + y2), 0.5 * height_m)
        size = (half, 0.5 * thickness_m, 0.5 * height_m)
        solids.append(Solid(centre, size, math.atan2(y2 - y1, x2 - x1)))
    return tuple(solids)


def default_solids() -> tuple[Solid, ...]:
    """Return the walls of the default hall as boxes."""
    return wall_solids(default_hall())
