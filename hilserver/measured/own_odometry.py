"""A pose that is the wheels' own odometry, passed off as a reference.

What localizes by a map publishes, between two corrections, the odometry that it was given. Such a
pose moves with every error of the wheels, the noise of their encoders included. No reference that
looks at the room knows that noise: what it says differs from the wheels by at least as much.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.measured.channels import POSITION, SIDES, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.measured.thresholds import (
    COPIED_NOISE,
    FEWEST_STEPS,
    LATEST_ROWS,
    TO_SD,
)

# variance of the third and of the second difference of white noise
THIRD: Final = 20.0
SECOND: Final = 6.0


@dataclass(frozen=True, slots=True)
class WheelWay:
    """How far the wheels went, up to a scale, as sums over the rows of one span."""

    t_s: Array
    # shape (n,); the unit is the signal's: rpm times seconds
    ahead: Array
    turned: Array
    noise: float  # standard deviation of one row's contribution


def without_own_odometry(log: MeasuredLog) -> MeasuredLog:
    """Return a log without position and heading that are nothing but the wheels' odometry."""
    ways = [wheel_way(log, span) for span in range(len(log.spans))]
    gone: list[str] = []
    if log.has(*POSITION) and _is_copied(_steps_ahead(log), ways, "ahead"):
        gone += POSITION
    if YAW in log and _is_copied(_steps(log, YAW), ways, "turned"):
        gone.append(YAW)
    if not gone:
        return log
    return log.without(gone).noticed(
        f"left out: {', '.join(gone)}, which repeats the noise of the wheel speeds: it is the"
        " odometry of these wheels and shows none of their errors; map a pose that was measured"
    )


def wheel_way(log: MeasuredLog, span: int) -> WheelWay | None:
    """Return how far the wheels went in a span; None if a side has too few samples there."""
    sides = []
    for names in ([f"wheel.{w}.speed_rpm" for w in side] for side in SIDES):
        known = [log[name].of(span) for name in names if name in log]
        there = [one for one in known if len(one[0])]  # a wheel may be silent in a span
        if not there or len(there[0][0]) < FEWEST_STEPS:
            return None
        t_s = there[0][0]
        values = [v if len(v) == len(t_s) else np.interp(t_s, t, v) for t, v in there]
        sides.append((t_s, np.mean(values, axis=0)))
    (t_s, left), (of_right, right) = sides
    right = np.interp(t_s, of_right, right)

    step_s = np.diff(t_s, prepend=t_s[0])
    both = (0.5 * (left - right), -0.5 * (left + right))
    rough = [np.median(np.abs(np.diff(speed, 3))) for speed in both]
    noise = TO_SD * float(np.min(rough)) / THIRD**0.5 * float(np.median(step_s))
    ahead, turned = (np.cumsum(speed * step_s) for speed in both)
    return WheelWay(t_s, ahead, turned, noise)


def _steps(log: MeasuredLog, name: str) -> list[tuple[Array, Array]]:
    """Return times and steps of an angle in each span, shapes (n,) and (n - 1,)."""
    found = []
    for span in range(len(log.spans)):
        t_s, values = log[name].of(span)
        found.append((t_s, np.diff(np.unwrap(values))))
    return found


def _steps_ahead(log: MeasuredLog) -> list[tuple[Array, Array]]:
    """Return times and distances between positions in each span."""
    found = []
    for span in range(len(log.spans)):
        (t_x, x), (t_y, y) = (log[name].of(span) for name in POSITION)
        t_s, at_x, at_y = np.intersect1d(t_x, t_y, return_indices=True)
        found.append((t_s, np.hypot(np.diff(x[at_x]), np.diff(y[at_y]))))
    return found


def _is_copied(
    steps: list[tuple[Array, Array]], ways: list[WheelWay | None], which: str
) -> bool:
    """Return whether steps of a pose repeat the noise of the wheels' steps, at any small delay."""
    pairs = [
        (t_s, moved, way)
        for (t_s, moved), way in zip(steps, ways, strict=True)
        if way is not None and way.noise > 0.0 and len(moved) > FEWEST_STEPS
    ]
    return bool(pairs) and any(
        _misfit(pairs, which, rows) < COPIED_NOISE
        for rows in np.arange(-LATEST_ROWS, LATEST_ROWS + 0.5, 0.5)
    )


def _misfit(
    pairs: list[tuple[Array, Array, WheelWay]], which: str, rows: float
) -> float:
    """Return the part of the pose's steps that the wheels do not have, by the wheels' noise.

    Parameters
    ----------
    rows : float
        By how many rows of the wheels the pose is late.
    """
    own, of_wheels, noise = [], [], []
    for t_s, moved, way in pairs:
        row_s = float(np.median(np.diff(way.t_s)))
        at_s = t_s - rows * row_s
        rolled = np.diff(np.interp(at_s, way.t_s, getattr(way, which)))
        rolled = np.abs(rolled) if which == "ahead" else rolled
        own.append(np.diff(moved, 2))
        of_wheels.append(np.diff(rolled, 2))
        per_step = max(float(np.median(np.diff(t_s))) / row_s, 1.0)
        noise.append(way.noise * (SECOND * per_step) ** 0.5)
    pose, wheels = np.concatenate(own), np.concatenate(of_wheels)
    # corrections of the map are few and large: the slope must not follow them
    usual = np.abs(pose) <= np.quantile(np.abs(pose), 0.9)
    square = float(wheels[usual] @ wheels[usual])
    if square <= 0.0:
        return np.inf
    scale = float(wheels[usual] @ pose[usual]) / square
    if scale == 0.0:
        return np.inf
    left = TO_SD * float(np.median(np.abs(pose - scale * wheels)))
    return left / (abs(scale) * float(np.median(noise)))
