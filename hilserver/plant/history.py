"""Rings of past samples, read at any age between two of them."""

import math

from hilserver.compiled import inlined, part
from hilserver.plant.layout import RING
from hilserver.plant.pose import wrap


@part
def weights(head: int, count: float, delay_runs: float) -> tuple[int, int, float]:
    """Return the rows of the samples around the given age, newer first, and the older one's share.

    Until the ring is full, the oldest sample stands for all earlier ones.
    """
    age = min(delay_runs, count - 1.0)
    whole = math.floor(age)
    newer = (head - whole + RING) % RING
    share = age - whole
    older = (newer - 1 + RING) % RING if share > 0.0 else newer
    return newer, older, share


@inlined
def between(newer: float, older: float, share: float) -> float:
    """Interpolate linearly between two samples; with a share of 0, return the newer itself."""
    if share == 0.0:
        return newer
    return newer + share * (older - newer)


@inlined
def between_angles(newer: float, older: float, share: float) -> float:
    """Interpolate between two angles along the shorter way, in (-pi, pi]."""
    if share == 0.0:
        return newer
    return float(wrap(newer + share * wrap(older - newer)))


@inlined
def push(head: float, count: float) -> tuple[int, float]:
    """Return the row for the next sample of a ring, and how many samples the ring then holds."""
    return (int(head) + 1) % RING, min(count + 1.0, RING)
