"""Steps in a log; their order, time constants and gain by Strejc's method, then least squares."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy.optimize import least_squares

from hilserver.arrays import Array
from hilserver.errors import LogError
from hilserver.identify.estimates import Estimate, blocks_of, regress
from hilserver.identify.strejc import (
    ORDER_MAX,
    Chain,
    Tangent,
    chain_of_lags,
    find_tangent,
    read_tangent,
    two_constants,
    two_lags,
)
from hilserver.identify.wheels import files, present
from hilserver.measured.data import MeasuredLog

_HOLD_S = 0.15
_BEFORE_S = 0.1
_LONGEST_S = 2.0
_SAMPLES_MIN = 6
_SMALLEST_SHARE = 0.05


@dataclass(frozen=True)
class InputStep:
    """One step of an input and the response."""

    t_s: Array  # shape (n,); time since the step, negative before it
    speed_rpm: Array  # shape (n,)
    size: float  # of the input, in its unit
    span: int
    at_s: float  # stamp of the step in its span


def find_steps(log: MeasuredLog, wheel: str, quantity: str) -> list[InputStep]:
    """Return the steps of ``wheel.{wheel}.{quantity}`` with a constant input before and after.

    The input in a row is valid from this row on; the instant of a step is known to within the
    distance of two rows.
    """
    found: list[InputStep] = []
    source = log[f"wheel.{wheel}.{quantity}"]
    speed = log[f"wheel.{wheel}.speed_rpm"]
    largest = float(np.max(np.abs(source.values), initial=0.0))
    for span in range(len(log.spans)):
        t_s, values = source.of(span)
        seen_s, seen = speed.of(span)
        if len(t_s) < 2 or len(seen_s) < _SAMPLES_MIN:
            continue
        changes = np.flatnonzero(np.diff(values) != 0.0) + 1
        edges = np.concatenate(([0], changes, [len(t_s)]))
        for i, change in enumerate(changes):
            size = float(values[change] - values[change - 1])
            since_s = t_s[edges[i]]
            at_s = float(t_s[change])
            if edges[i + 2] < len(t_s):
                until_s = t_s[edges[i + 2]]
            else:
                until_s = seen_s[-1] + 1e-9
            held = at_s - since_s >= _BEFORE_S and until_s - at_s >= _HOLD_S
            if not held or abs(size) < _SMALLEST_SHARE * largest:
                continue
            begin_s = max(since_s + 0.8 * (at_s - since_s), at_s - _BEFORE_S)
            end_s = min(until_s, at_s + _LONGEST_S)
            rows = (seen_s >= begin_s) & (seen_s < end_s)
            before = (seen_s[rows] < at_s).sum()
            after = (seen_s[rows] >= at_s).sum()
            if before >= 1 and after >= _SAMPLES_MIN:
                found.append(
                    InputStep(seen_s[rows] - at_s, seen[rows], size, span, at_s)
                )
    return found


def averaged(steps: list[InputStep]) -> tuple[Array, Array]:
    """Return the mean response per unit of the input on a grid, from the step on.

    Each response starts from its own mean before the step; the grid ends at their median length.
    """
    steps_s = [np.median(np.diff(step.t_s)) for step in steps]
    grid_s = float(np.median(steps_s))
    length_s = float(np.median([step.t_s[-1] for step in steps]))
    t_s = np.arange(0.0, length_s, grid_s)
    total = np.zeros(len(t_s))
    count = np.zeros(len(t_s))
    for step in steps:
        start = float(np.mean(step.speed_rpm[step.t_s < 0.0]))
        inside = t_s <= step.t_s[-1]
        answer = np.interp(t_s, step.t_s, (step.speed_rpm - start) / step.size)
        total += np.where(inside, answer, 0.0)
        count += inside
    return t_s, total / np.maximum(count, 1.0)


Response = Callable[[Array, Array], Array]

INPUTS: Final = ("duty_pct", "setpoint_rpm")
SATURATED_PCT: Final = 99.0
_SETTLED = 3.0
_BLOCK_S = 0.25
_ANSWER_MIN = 0.1


@dataclass(frozen=True)
class StepResponse:
    """The response of the wheels to the steps of one input."""

    input: str  # ``duty_pct``: the process; ``setpoint_rpm``: the closed loop
    wheels: tuple[str, ...]
    steps: int
    # graphical: at the point of inflection of the mean response
    tangent: Tangent
    strejc: Chain
    two_point_s: tuple[float, float]  # graphical: T1 and T2
    # fitted chain of equal time constants, of the order that fits best
    order: int
    time_constant: Estimate
    chain_gain: Estimate
    # fitted pair of time constants
    t1: Estimate
    t2: Estimate
    gain: Estimate
    rms_rpm: tuple[float, float]  # residuals of both fits: chain, pair
    flags: tuple[str, ...] = field(default=())


def identify_steps(log: MeasuredLog, source: str | None = None) -> StepResponse:
    """Identify the step response of all wheels of a log together.

    The first input that has steps is used, unless `source` names one. LogError if no input jumps
    and then holds.
    """
    quantity, by_wheel = _steps(log, INPUTS if source is None else (source,))
    steps = [step for own in by_wheel.values() for step in own]
    flags = _flags(log, quantity, by_wheel)
    t_s, mean = averaged(steps)
    tail = mean[-max(3, len(mean) // 4) :]
    final = float(np.median(tail))
    least = _ANSWER_MIN * float(np.max(np.abs(mean)))
    if not abs(final) > least or not mean.any():
        raise LogError(f"{files(log)}: the wheels do not follow {quantity}")
    tangent = find_tangent(t_s, mean / final)
    pair = two_constants(t_s, mean / final)
    if t_s[-1] < _SETTLED * sum(pair):
        flags.append(
            "the steps end before the wheels have settled, so the gain is uncertain"
        )
    fits = _Fits(steps, "rpm/%" if quantity == "duty_pct" else "1", final)
    order, chain = fits.chain(sum(pair))
    two = fits.pair(pair)
    wheels = tuple(wheel for wheel, own in by_wheel.items() if own)
    return StepResponse(
        quantity,
        wheels,
        len(steps),
        tangent,
        read_tangent(tangent),
        pair,
        order,
        chain.estimates[0],
        chain.gain,
        two.estimates[0],
        two.estimates[1],
        two.gain,
        (chain.rms, two.rms),
        tuple(flags),
    )


def _steps(
    log: MeasuredLog, inputs: Sequence[str]
) -> tuple[str, dict[str, list[InputStep]]]:
    """Return the first input that has steps, and those of each wheel."""
    for quantity in inputs:
        wheels = [w for w in present(log, quantity) if f"wheel.{w}.speed_rpm" in log]
        by_wheel = {wheel: find_steps(log, wheel, quantity) for wheel in wheels}
        if any(by_wheel.values()):
            return quantity, by_wheel
    raise LogError(
        f"{files(log)}: no wheel has a step with constant input for 0.1 s before and 0.15 s"
        f" after it, and a speed; record steps of {' or '.join(inputs)}"
    )


def _flags(
    log: MeasuredLog, quantity: str, by_wheel: dict[str, list[InputStep]]
) -> list[str]:
    if quantity == "duty_pct":
        return []
    flags = ["the input is the set-point, so this is the response of the closed loop"]
    for wheel, steps in by_wheel.items():
        if steps and f"wheel.{wheel}.duty_pct" in log:
            duty = log[f"wheel.{wheel}.duty_pct"].values
            if np.max(np.abs(duty)) >= SATURATED_PCT:
                flags.append(
                    f"the drive of {wheel} saturates, so its response is not linear"
                )
    return flags


@dataclass(frozen=True)
class _Fit:
    estimates: list[Estimate]
    gain: Estimate
    rms: float


class _Fits:
    """Least squares over all steps; the speed before each step is free."""

    def __init__(self, steps: list[InputStep], gain_unit: str, gain: float) -> None:
        self._unit = gain_unit
        self._gain = gain
        self._t_s = np.concatenate([step.t_s for step in steps])
        self._speed = np.concatenate([step.speed_rpm for step in steps])
        lengths = [len(step.t_s) for step in steps]
        self._owner = np.repeat(np.arange(len(steps)), lengths)
        self._size = np.repeat([step.size for step in steps], lengths)
        self._blocks = self._owner
        if len(steps) < 6:
            self._blocks = blocks_of(self._t_s, self._owner, _BLOCK_S)

    def chain(self, total_s: float) -> tuple[int, _Fit]:
        """Fit chains of equal time constants; return the best order and its fit."""
        fits = {
            order: self._fit(
                lambda t_s, log_t, n=order: chain_of_lags(t_s, n, math.exp(log_t[0])),  # type: ignore[misc]
                [math.log(total_s / order)],
            )
            for order in range(1, ORDER_MAX + 1)
        }
        return min(fits.items(), key=lambda item: item[1].rms)

    def pair(self, start_s: tuple[float, float]) -> _Fit:
        """Fit two time constants, the larger first."""
        smallest = 1e-4 * start_s[0]
        second = math.log(max(start_s[1], 20.0 * smallest))
        start = [math.log(start_s[0]), second]
        fit = self._fit(
            lambda t_s, log_t: np.asarray(two_lags(t_s, *np.exp(log_t))), start
        )
        if fit.estimates[0].value < fit.estimates[1].value:
            fit = _Fit(fit.estimates[::-1], fit.gain, fit.rms)
        return fit

    def _fit(self, response: Response, start: list[float]) -> _Fit:
        """Fit the logarithms of the time constants, and the gain."""

        def left(theta: Array) -> Array:
            modelled = theta[-1] * self._answer(response, theta[:-1])
            return self._centred(self._speed - modelled)

        first = [*start, self._gain]
        scales = [*([0.1] * len(start)), 1.0]
        found = least_squares(left, first, x_scale=scales)
        theta = found.x
        rest = found.fun
        spread = regress(-found.jac, rest, self._blocks)
        estimates = []
        for i, log_t in enumerate(theta[:-1]):
            value = spread.estimate(i).ci95
            limits = None if value is None else _exponential(log_t, value)
            estimates.append(Estimate(math.exp(log_t), limits, "s"))
        around = spread.estimate(len(theta) - 1).ci95
        gain = float(theta[-1])
        if around is None:
            interval = None
        else:
            interval = (gain + around[0], gain + around[1])
        rms = float(np.sqrt(np.mean(np.square(rest))))
        return _Fit(estimates, Estimate(gain, interval, self._unit), rms)

    def _answer(self, response: Response, log_t: Array) -> Array:
        answer = np.where(self._t_s >= 0.0, response(self._t_s, log_t), 0.0)
        return self._size * answer

    def _centred(self, values: Array) -> Array:
        """Subtract the mean of each step, because its starting speed is free."""
        sums = np.bincount(self._owner, values)
        centred: Array = values - (sums / np.bincount(self._owner))[self._owner]
        return centred


def _exponential(log_t: float, around: tuple[float, float]) -> tuple[float, float]:
    low, high = (math.exp(min(log_t + value, 50.0)) for value in around)
    return low, high
