"""Rings of past samples, read at any age between two of them."""

import math

from hilserver.plant.kernels import part
from hilserver.plant.layout import RING
from hilserver.plant.pose import wrap


@part
def weights(head: int, count: float, delay_runs: float) -> tuple[int, int, float]:
    """Return the rows of the ring just after and before the asked age, and the older one's share.

    Before the ring has filled, the oldest sample stands for what lies before it.
    """
    age = min(delay_runs, count - 1.0)
    whole = math.floor(age)
    newer = (head - whole + RING) % RING
    share = age - whole
    older = (newer - 1 + RING) % RING if share > 0.0 else newer
    return newer, older, share


@part
def between(newer: float, older: float, share: float) -> float:
    """Return the linear mean of two samples; without a share of the older, the newer itself."""
    if share == 0.0:
        return newer
    return newer + share * (older - newer)


@part
def between_angles(newer: float, older: float, share: float) -> float:
    """Return the mean of two angles along the shorter way, in (-pi, pi]."""
    if share == 0.0:
        return newer
    return float(wrap(newer + share * wrap(older - newer)))


@part
def push(head: float, count: float) -> tuple[int, float]:
    """Return the row of a ring that takes the next sample, and how many the ring then holds."""
    return (int(head) + 1) % RING, min(count + 1.0, RING)
