"""The distance of a robot to a way in the plane."""

from itertools import pairwise

import numpy as np

from hilserver.arrays import Array


def distance_to_way(x_m: Array, y_m: Array, way: Array) -> Array:
    """Return the distance of points to the nearest piece of a polyline [m], shape (n,).

    Parameters
    ----------
    x_m, y_m : ndarray, shape (n,)
    way : ndarray, shape (k, 2)
        Corners, two at least.
    """
    nearest = np.full(len(x_m), np.inf)
    for (ax, ay), (bx, by) in pairwise(way.tolist()):
        dx, dy = bx - ax, by - ay
        length2 = dx * dx + dy * dy
        along = np.zeros(len(x_m))
        if length2 > 0.0:
            along = np.clip(((x_m - ax) * dx + (y_m - ay) * dy) / length2, 0.0, 1.0)
        square = (x_m - ax - along * dx) ** 2 + (y_m - ay - along * dy) ** 2
        nearest = np.minimum(nearest, square)
    distance: Array = np.sqrt(nearest)
    return distance
