"""The sampled wheel speed loop: its matrices, its stability, and the longest stable period."""

import math
from dataclasses import dataclass

from hilserver.compiled import plain
from hilserver.plant.drive import Matrices


@plain
def euler_matrices(
    gain: float, viscous: float, t1_s: float, t2_s: float, dt_s: float
) -> Matrices:
    """Return the same as `process_matrices`, by forward differences."""
    slow, fast = dt_s / t1_s, dt_s / t2_s
    return 1.0 - slow, -gain * viscous * slow, fast, 1.0 - fast, gain * slow, 0.0


@plain
def derivative(
    k_p: float, k_d: float, derivative_n: float, dt_s: float
) -> tuple[float, float]:
    """Return keep and gain of the filtered derivative, by backward differences."""
    if k_d == 0.0:
        return 0.0, 0.0
    tau_s = k_d / (derivative_n * k_p)
    return tau_s / (tau_s + dt_s), k_d / (tau_s + dt_s)


@plain
def is_stable(
    gain: float,
    t1_s: float,
    t2_s: float,
    k_p: float,
    k_i: float,
    k_d: float,
    derivative_n: float,
    dt_s: float,
    euler: bool,
) -> bool:
    """Return whether all poles of the loop, unsaturated, are inside the unit circle.

    The poles of a slow process crowd at ``z = 1`` and differ from it in their last digits only.
    Therefore all is computed in ``w = z - 1`` (delta operator; Middleton and Goodwin, 1990), and no
    coefficient is a difference of nearly equal numbers. The process is
    ``(q1 w + q0) / (w^2 + s1 w + s0)`` from duty to speed, the controller
    ``k_p + k_i_step / w + gain_d w / (w + r)``.
    """
    slow, fast = min(dt_s / t1_s, dt_s / t2_s), max(dt_s / t1_s, dt_s / t2_s)
    if euler:
        w1, w2, q1 = -slow, -fast, 0.0
    else:
        w1, w2 = math.expm1(-slow), math.expm1(-fast)
        apart = fast - slow
        share = -math.expm1(-apart) / apart if apart > 0.0 else 1.0
        # the step response after one tick
        q1 = gain * (-w1 - (1.0 + w1) * slow * share)
    s1, s0 = -(w1 + w2), w1 * w2
    q0 = gain * s0  # a held duty leads to its steady speed

    r, gain_d = 1.0, 0.0
    if k_d > 0.0:
        bandwidth = derivative_n * k_p
        r = dt_s * bandwidth / (k_d + dt_s * bandwidth)
        gain_d = k_d * bandwidth / (k_d + dt_s * bandwidth)
    k_i_step = dt_s * k_i
    # without an integral, w + 1 takes the place of its w
    other = 1.0 if k_i == 0.0 else 0.0
    n2 = k_p + gain_d
    n1 = k_p * (r + other) + gain_d * other + k_i_step
    n0 = k_p * r * other + k_i_step * r
    return inside_unit_circle(  # type: ignore[no-any-return]
        s1 + r + other + q1 * n2,
        s0 + s1 * (r + other) + r * other + q1 * n1 + q0 * n2,
        s0 * (r + other) + s1 * r * other + q1 * n0 + q0 * n1,
        s0 * r * other + q0 * n0,
    )


@plain
def inside_unit_circle(a: float, b: float, c: float, d: float) -> bool:
    """Return whether ``|1 + w| < 1`` for all roots of ``w^4 + a w^3 + b w^2 + c w + d``.

    ``w = 2 v / (1 - v)`` takes the circle to the left half plane, where Routh's criterion decides
    (Astrom and Wittenmark, 3.3).
    """
    h4 = 16.0 - 8.0 * a + 4.0 * b - 2.0 * c + d
    h3 = 8.0 * a - 8.0 * b + 6.0 * c - 4.0 * d
    h2 = 4.0 * b - 6.0 * c + 6.0 * d
    h1 = 2.0 * c - 4.0 * d
    minor = h3 * h2 - h4 * h1
    positive = h4 > 0.0 and h3 > 0.0 and h2 > 0.0 and h1 > 0.0 and d > 0.0
    return bool(positive and minor > 0.0 and minor * h1 > h3 * h3 * d)


@dataclass(frozen=True, slots=True, kw_only=True)
class ControlLoop:
    """A PI(D) controller around the process of equation (5.23)."""

    gain: float  # speed per duty [rpm/%]
    # time constants of the two first-order lags
    t1_s: float
    t2_s: float
    # gains in parallel form [%/rpm], [%/(rpm s)], [% s/rpm]
    k_p: float
    k_i: float
    k_d: float
    derivative_n: float  # the derivative is filtered with ``tau = K_D/(N K_P)``
    euler: bool  # forward differences instead of the exact solution

    def is_stable(self, dt_s: float) -> bool:
        """Return whether the loop is stable when sampled at `dt_s`."""
        return bool(
            is_stable(
                self.gain,
                self.t1_s,
                self.t2_s,
                self.k_p,
                self.k_i,
                self.k_d,
                self.derivative_n,
                dt_s,
                self.euler,
            )
        )

    def largest_period_s(self, unstable_s: float) -> float:
        """Return the longest stable period below an unstable one."""
        low, high = 0.0, unstable_s
        for _ in range(40):
            middle = 0.5 * (low + high)
            if self.is_stable(middle):
                low = middle
            else:
                high = middle
        return low
