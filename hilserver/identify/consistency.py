"""The checks of section 5.2.1: front and rear wheels agree, and so do all signs."""

from dataclasses import dataclass

import numpy as np

from hilserver.identify.estimates import Estimate, blocks_of, regress
from hilserver.identify.rotation import RotationGain
from hilserver.identify.wheels import at, per_span
from hilserver.measured.data import MeasuredLog

LEAST_DEVIATION = 0.01
_SAMPLES_MIN = 20


@dataclass(frozen=True)
class Check:
    """One check: passed, failed, or None if the log does not show it."""

    name: str
    passed: bool | None
    text: str
    figure: Estimate | None = None


def check_sides(log: MeasuredLog) -> list[Check]:
    """Return "front = rear" of both sides: the factor between the two wheels' speeds."""
    return [_front_is_rear(log, side) for side in ("l", "r")]


def check_sign(gain: RotationGain) -> Check:
    """Return "sign": with the plant's signs K_om is positive."""
    interval = gain.unsteady.ci95
    if interval is None or interval[0] <= 0.0 <= interval[1]:
        return Check(
            "sign", None, "the robot turns too little to show the sign", gain.unsteady
        )
    passed = interval[0] > 0.0
    if passed:
        text = "left forward and right backward turns the robot as the configured yaw_sign says"
    else:
        text = (
            "the yaw runs opposite to the wheels: sides swapped, yaw sign flipped, or wrong"
            " yaw_sign"
        )
    return Check("sign", passed, text, gain.unsteady)


def _front_is_rear(log: MeasuredLog, side: str) -> Check:
    name = f"front = rear, {'left' if side == 'l' else 'right'}"
    front = f"wheel.f{side}.speed_rpm"
    rear = f"wheel.r{side}.speed_rpm"
    if not log.has(front, rear):
        return Check(name, None, f"the log does not contain both {front} and {rear}")
    x = log[front].values
    y = per_span(log, front, lambda span, t_s: at(log[rear], span, t_s))
    good = np.isfinite(y)
    least = 0.1 * np.max(np.abs(x), initial=0.0)
    moving = good & (np.abs(x) > least)
    if moving.sum() < _SAMPLES_MIN:
        return Check(name, None, "the wheels hardly turn")
    block = blocks_of(log[front].t_s, log[front].span)
    fit = regress(x[moving, None], y[moving], block[moving])
    ratio = fit.estimate(0)
    difference = y[moving] - x[moving]
    apart = float(np.sqrt(np.mean(np.square(difference))))
    passed = ratio.holds(1.0) or abs(ratio.value - 1.0) <= LEAST_DEVIATION
    text = f"rear / front = {ratio.value:.4f}, {apart:.2g} rpm rms apart"
    return Check(name, bool(passed), text, ratio)
