"""The sampled wheel speed loop: its matrices, its stability, and the longest stable period."""

from dataclasses import dataclass

from hilserver.compiled import plain
from hilserver.plant.drive import Matrices, process_matrices


@plain
def euler_matrices(gain: float, viscous: float, t1_s: float, t2_s: float, dt_s: float) -> Matrices:
    """Return the same as `process_matrices`, by forward differences."""
    slow, fast = dt_s / t1_s, dt_s / t2_s
    return 1.0 - slow, -gain * viscous * slow, fast, 1.0 - fast, gain * slow, 0.0


@plain
def derivative(k_p: float, k_d: float, derivative_n: float, dt_s: float) -> tuple[float, float]:
    """Return keep and gain of the filtered derivative, by backward differences."""
    if k_d == 0.0:
        return 0.0, 0.0
    tau_s = k_d / (derivative_n * k_p)
    return tau_s / (tau_s + dt_s), k_d / (tau_s + dt_s)


@plain
def is_stable(process: Matrices, k_p: float, k_i_step: float, keep: float, gain: float) -> bool:
    """Return whether all poles of the loop, unsaturated, are inside the unit circle.

    The process is ``(q1 z + q0) / (z^2 + p1 z + p0)`` from duty to speed, the controller
    ``k_p + k_i_step / (z - 1) + gain (z - 1) / (z - keep)``. Without an integral, its pole at
    1 is replaced by one at 0. Jury's criterion (Astrom and Wittenmark, 3.3).
    """
    a00, a01, a10, a11, b0, b1 = process
    p1, p0 = -(a00 + a11), a00 * a11 - a01 * a10
    q1, q0 = b1, a10 * b0 - a00 * b1
    if k_i_step == 0.0:
        n1, n0 = k_p + gain, -k_p * keep - gain
        a = p1 - keep + q1 * n1
        b = p0 - p1 * keep + q1 * n0 + q0 * n1
        c, d = q0 * n0 - p0 * keep, 0.0
    else:
        d1, d0 = -(1.0 + keep), keep
        n2 = k_p + gain
        n1 = k_p * d1 + k_i_step - 2.0 * gain
        n0 = k_p * d0 - k_i_step * keep + gain
        a = p1 + d1 + q1 * n2
        b = p0 + p1 * d1 + d0 + q1 * n1 + q0 * n2
        c = p0 * d1 + p1 * d0 + q1 * n0 + q0 * n1
        d = p0 * d0 + q0 * n0
    # Jury's table of z^4 + a z^3 + b z^2 + c z + d: the cubic, then the quadratic
    e3, e2, e1, e0 = 1.0 - d * d, a - c * d, b - b * d, c - a * d
    f2, f0 = e3 * e3 - e0 * e0, e3 * e1 - e0 * e2
    at_ends = 1.0 + a + b + c + d > 0.0 and 1.0 - a + b - c + d > 0.0
    return bool(abs(d) < 1.0 and at_ends and abs(e0) < e3 and abs(f0) < f2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
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

    def process(self, dt_s: float) -> Matrices:
        """Return ``a00, a01, a10, a11, b0, b1`` of the process over one tick with the duty held."""
        solve = euler_matrices if self.euler else process_matrices
        matrices: Matrices = solve(self.gain, 0.0, self.t1_s, self.t2_s, dt_s)
        return matrices

    def derivative(self, dt_s: float) -> tuple[float, float]:
        """Return keep and gain of the filtered derivative, by backward differences."""
        found: tuple[float, float] = derivative(self.k_p, self.k_d, self.derivative_n, dt_s)
        return found

    def is_stable(self, dt_s: float) -> bool:
        """Return whether the loop is stable when sampled at `dt_s`."""
        keep, gain = self.derivative(dt_s)
        return bool(is_stable(self.process(dt_s), self.k_p, dt_s * self.k_i, keep, gain))

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
