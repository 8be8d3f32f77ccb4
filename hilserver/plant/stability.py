"""The sampled wheel speed loop: its matrices, its spectral radius, and the slice it allows."""

import math
from dataclasses import dataclass
from typing import cast

import numpy as np
from numpy.typing import NDArray

from hilserver.plant.drive import process_matrices

Matrices = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class Loop:
    """A PI(D) controller around the process of equation (5.23), to be sampled."""

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

    def process(self, dt_s: float, viscous: float = 0.0) -> Matrices:
        """Return ``a00, a01, a10, a11, b0, b1`` of the process over one tick with the duty held."""
        if self.euler:
            slow, fast = dt_s / self.t1_s, dt_s / self.t2_s
            coupling = -self.gain * viscous * slow
            return 1.0 - slow, coupling, fast, 1.0 - fast, self.gain * slow, 0.0
        solve = process_matrices.py_func
        return cast("Matrices", solve(self.gain, viscous, self.t1_s, self.t2_s, dt_s))

    def derivative(self, dt_s: float) -> tuple[float, float]:
        """Return keep and gain of the filtered derivative, by backward differences."""
        if self.k_d == 0.0:
            return 0.0, 0.0
        tau_s = self.k_d / (self.derivative_n * self.k_p)
        return tau_s / (tau_s + dt_s), self.k_d / (tau_s + dt_s)

    def matrix(self, dt_s: float) -> NDArray[np.float64]:
        """Return the loop over (motor, speed, integral, derivative, last error), unsaturated."""
        a00, a01, a10, a11, b0, b1 = self.process(dt_s)
        keep, gain = self.derivative(dt_s)
        motor, speed, integral, derivative, last = np.eye(5)
        error = -speed
        derivative_next = keep * derivative + gain * (error - last)
        duty = self.k_p * error + integral + derivative_next
        return np.stack(
            [
                a00 * motor + a01 * speed + b0 * duty,
                a10 * motor + a11 * speed + b1 * duty,
                integral + dt_s * self.k_i * error,
                derivative_next,
                error,
            ]
        )

    def spectral_radius(self, dt_s: float) -> float:
        """Return the largest magnitude of the loop's poles when sampled at `dt_s`."""
        loop = self.matrix(dt_s)
        if not np.all(np.isfinite(loop)):
            return math.inf
        if self.k_i == 0.0:  # the integral then stands still and is no pole
            loop = np.delete(np.delete(loop, 2, axis=0), 2, axis=1)
        return float(np.max(np.abs(np.linalg.eigvals(loop))))

    def largest_period_s(self, unstable_s: float) -> float:
        """Return the period at which the loop leaves stability, below an unstable one."""
        low, high = 0.0, unstable_s
        for _ in range(40):
            middle = 0.5 * (low + high)
            if self.spectral_radius(middle) < 1.0:
                low = middle
            else:
                high = middle
        return low
