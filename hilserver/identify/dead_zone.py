"""The dead zone of a drive from a slow sweep of the duty."""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.errors import LogError
from hilserver.identify.estimates import Estimate
from hilserver.identify.wheels import files, present
from hilserver.measured.data import Channel, MeasuredLog

RESTING_RPM: Final = 1.0
# share of the samples between the edges at which the wheel must rest
MOSTLY: Final = 0.5


@dataclass(frozen=True)
class DeadZone:
    """Duty at which a wheel stands still, from the lower to the upper edge.

    The interval of an edge runs from the last resting to the first turning duty of the sweep.
    At the edge where the sweep enters the zone the wheel is turning and stops late, as kinetic
    friction is below static friction: the zone is not symmetric.
    """

    wheel: str
    lower_pct: Estimate
    upper_pct: Estimate
    held_rows: int


def identify_dead_zone(
    log: MeasuredLog, resting_rpm: float = RESTING_RPM
) -> list[DeadZone]:
    """Identify the dead zone of every wheel with duty and speed.

    LogError if no wheel is swept across rest.
    """
    found = []
    for wheel in present(log, "duty_pct"):
        if f"wheel.{wheel}.speed_rpm" not in log:
            continue
        zone = _of_wheel(log, wheel, resting_rpm)
        if zone is not None:
            found.append(zone)
    if not found:
        raise LogError(
            f"{files(log)}: no wheel's duty is swept from backward rotation through standstill"
            " to forward rotation; the dead zone needs such a sweep, slower than the wheels respond"
        )
    return found


def _of_wheel(log: MeasuredLog, wheel: str, resting_rpm: float) -> DeadZone | None:
    speed = log[f"wheel.{wheel}.speed_rpm"]
    duty = log[f"wheel.{wheel}.duty_pct"]
    common, rows, own = np.intersect1d(_keys(duty), _keys(speed), return_indices=True)
    if len(common) < 3:
        return None
    level = duty.values[rows]
    turning = speed.values[own]
    # A speed is only held where it is the same to the last digit while the duty changes sign:
    # encoders that time their edges hold the last one when no further edge comes, at a stop.
    held = np.zeros(len(turning), dtype=bool)
    edges = np.flatnonzero(np.diff(turning) != 0.0) + 1
    for first, end in zip((0, *edges), (*edges, len(turning)), strict=True):
        run = level[first:end]
        if turning[first] != 0.0 and end - first >= 3 and run.min() <= 0.0 <= run.max():
            held[first:end] = True
    resting = (np.abs(turning) <= resting_rpm) | held
    if not resting.any() or not (turning < -resting_rpm).any():
        return None
    low = float(level[resting].min())
    high = float(level[resting].max())
    inside = (level >= low) & (level <= high)
    if (
        np.mean(resting[inside]) < MOSTLY
    ):  # faster than the wheels, which then rest at any duty
        return None
    below = level[level < low]
    above = level[level > high]
    if not (len(below) and len(above)):
        return None
    lower = (float(below.max()), low)
    upper = (high, float(above.min()))
    lower_edge = Estimate(sum(lower) / 2.0, lower, "%")
    upper_edge = Estimate(sum(upper) / 2.0, upper, "%")
    return DeadZone(
        wheel,
        lower_edge,
        upper_edge,
        int(held.sum()),
    )


def _keys(channel: Channel) -> NDArray[np.void]:
    """Return stamp and span of every sample as one comparable value."""
    columns = [("span", np.int64), ("t_s", np.float64)]
    keys = np.zeros(len(channel), dtype=columns)
    keys["span"] = channel.span
    keys["t_s"] = channel.t_s
    return keys
