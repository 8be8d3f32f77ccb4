"""The hall that the range finders see: walls as line segments."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

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
