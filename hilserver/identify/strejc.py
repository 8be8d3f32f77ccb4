"""Strejc's method: order and time constant from the tangent at the point of inflection.

A chain of n equal first-order lags, ``1/(T s + 1)^n``, has its inflection at ``(n - 1) T``. The
tangent there cuts the time axis at T_u and reaches the final value T_n later; T_u/T_n depends on n
alone. Below the ratio of n = 2 the process has two unequal time constants.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq
from scipy.special import gammainc

from hilserver.arrays import Array

ORDER_MAX = 6


@dataclass(frozen=True)
class Tangent:
    """The tangent at the point of inflection of a normalised step response."""

    delay_s: float
    rise_s: float

    @property
    def ratio(self) -> float:
        """T_u / T_n."""
        return self.delay_s / self.rise_s


@dataclass(frozen=True)
class Chain:
    """The chain that Strejc's method reads from a tangent: `order` equal time constants."""

    order: int
    time_constant_s: float


def tangent_of_chain(order: int) -> Tangent:
    """Return the tangent of ``1/(s + 1)^order``, times in units of T."""
    at = float(order - 1)
    power = at ** (order - 1) * math.exp(-at)
    slope = power / math.factorial(order - 1)
    value = float(gammainc(order, at)) if order > 1 else 0.0
    return Tangent(at - value / slope, 1.0 / slope)


def read_tangent(tangent: Tangent) -> Chain:
    """Return the chain whose ratio is nearest to the tangent's.

    Order 1 means "well below order 2"; `two_constants` then gives more information.
    """
    order = min(
        range(1, ORDER_MAX + 1),
        key=lambda n: abs(tangent_of_chain(n).ratio - tangent.ratio),
    )
    return Chain(order, tangent.rise_s / tangent_of_chain(order).rise_s)


def find_tangent(t_s: Array, response: Array) -> Tangent:
    """Return the tangent of a normalised (0 to 1), noisy response at rising stamps.

    The slope is that of the steepest cubic through a stretch as long as the rise from 30 to 70 %.
    """
    third = first_reach(t_s, response, 0.3)
    most = first_reach(t_s, response, 0.7)
    grain_s = 2.51 * float(np.median(np.diff(t_s)))
    width = max(0.5 * (most - third), grain_s)
    best = (0.0, 0.0, 0.0)
    for centre in t_s[(t_s >= 0.0) & (t_s <= most)]:
        near = np.abs(t_s - centre) <= width
        if near.sum() < 5:
            continue
        scaled = (t_s[near] - centre) / width
        *_, slope, level = np.polyfit(scaled, response[near], 3)
        slope /= width
        if slope > best[0]:
            best = (float(slope), float(centre), float(level))
    slope, centre, level = best
    if slope <= 0.0:
        return Tangent(0.0, float(t_s[-1]))
    return Tangent(max(centre - level / slope, 0.0), 1.0 / slope)


def first_reach(t_s: Array, response: Array, share: float) -> float:
    """Return when the response first reaches a share of 1, interpolated; last stamp if never."""
    above = np.flatnonzero(response >= share)
    if not len(above):
        return float(t_s[-1])
    i = int(above[0])
    if i == 0 or response[i] == response[i - 1]:
        return float(t_s[i])
    rise = response[i] - response[i - 1]
    part = (share - response[i - 1]) / rise
    step_s = t_s[i] - t_s[i - 1]
    return float(t_s[i - 1] + part * step_s)


def two_constants(t_s: Array, response: Array) -> tuple[float, float]:
    """Return T1 >= T2 from two points: the sum from 72 %, the ratio from the value at 0.36 of it.

    Every response of two lags passes 72 % at about 1.256 (T1 + T2); at 0.3574 (T1 + T2) their
    ratio shows most.
    """
    total = first_reach(t_s, response, 0.72) / 1.2564
    value = float(np.interp(0.3574 * total, t_s, response))
    limits = [two_lags(0.3574, 1.0 - part, part) for part in (1e-4, 0.4999)]
    if value >= limits[0]:
        return total, 0.0
    if value <= limits[1]:
        return 0.5 * total, 0.5 * total
    part = float(brentq(lambda p: two_lags(0.3574, 1.0 - p, p) - value, 1e-4, 0.4999))
    return total * (1.0 - part), total * part


def two_lags(t_s: Array | float, t1_s: float, t2_s: float) -> Array | float:
    """Return the step response of ``1/((T1 s + 1)(T2 s + 1))``; 0 before the step."""
    t = np.maximum(t_s, 0.0)
    if abs(t1_s - t2_s) < 1e-6 * t1_s:
        x = t / t1_s
        return 1.0 - np.exp(-x) * (1.0 + x)
    slow = t1_s * np.exp(-t / t1_s)
    fast = t2_s * np.exp(-t / max(t2_s, 1e-12))
    return 1.0 - (slow - fast) / (t1_s - t2_s)


def chain_of_lags(t_s: Array, order: int, time_constant_s: float) -> Array:
    """Return the step response of ``1/(T s + 1)^order``; 0 before the step."""
    response: Array = gammainc(order, np.maximum(t_s, 0.0) / time_constant_s)
    return response
