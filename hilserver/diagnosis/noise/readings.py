"""What a sensor shows of a quantity: rounded to its resolution and held at its limits.

A reading is ``y = clip(round(x + e))``. If the noise e is smaller than the step q, the error of
rounding depends on the quantity itself: with a sawtooth's Fourier series its mean over the noise is
``sum_k (-1)^k q/(pi k) exp(-2 pi^2 k^2 s^2/q^2) sin(2 pi k x/q)`` (Widrow and Kollar, Quantization
Noise, 2008), so it lasts as long as the quantity does. At a limit the mean reading stays below it,
as the mean of a censored normal does (Tobin 1958).
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.optimize import brentq
from scipy.special import ndtr

from hilserver.arrays import Array
from hilserver.diagnosis.noise.whitening import NoiseModel
from hilserver.diagnosis.thresholds import FEWEST_SAMPLES, NEGLIGIBLE, READING_CALM
from hilserver.measured.resolution import step_of

NOISE_BY_STEP: Final = (0.02, 50.0)
"""Range in which noise is searched: below, rounding hides it; above, nothing shows the rounding."""
LATER_S: Final = 0.1  # lasting errors of rounding are still alike
FLOOR_SD = 1e-6  # deviation that a channel without any noise is given
HARMONICS = np.arange(1, 6)


@dataclass(frozen=True, slots=True)
class Reading:
    """How a channel shows a quantity."""

    step: float = 0.0  # readings differ by whole multiples of it; 0 if not rounded
    origin: float = 0.0  # one of the readings
    limit: float = math.inf  # largest reading, either sign

    @classmethod
    def of(cls, values: Array, limit: float = math.inf) -> "Reading":
        """Return how a channel is rounded; its limit need not be a multiple of its step."""
        return cls(*step_of(values[np.abs(values) < limit]), limit)

    def mean(self, exact: Array, noise: NoiseModel | None) -> Array:
        """Return the mean reading of a quantity, without what rounding adds, shape (n,).

        Parameters
        ----------
        exact : ndarray, shape (n,)
            The quantity.
        noise : NoiseModel or None
            Of the channel; None if not known yet.
        """
        shown = np.clip(exact, -self.limit, self.limit)
        if noise is None or math.isinf(self.limit):
            return shown
        sd = math.sqrt(max(noise.sd**2 - self.step**2 / 12.0 - FLOOR_SD**2, 0.0))
        if sd < FLOOR_SD:
            return shown  # a simulated sensor: its noise model only serves as divisor
        short = self._short(sd)
        for side in (1.0, -1.0):
            away = np.abs(side * exact - self.limit) / sd
            near = away < 6.0
            z = away[near]
            bump = np.exp(-0.5 * z * z) - math.sqrt(2.0 * math.pi) * z * ndtr(-z)
            shown[near] -= side * short * bump
        return shown

    def _short(self, sd: float) -> float:
        """Return how far the mean reading of a quantity at the limit is below it."""
        if self.step < 0.5 * sd:
            return sd / math.sqrt(2.0 * math.pi)
        cells = np.arange(int(6.0 * sd / self.step) + 1) + 0.5
        return float(self.step * ndtr(-cells * self.step / sd).sum())


def lasting(noise_sd: float, step: float) -> float:
    """Return the variance of the mean rounding error over all places between two steps."""
    size = (
        step
        / (math.pi * HARMONICS)
        * np.exp(-2.0 * (math.pi * HARMONICS * noise_sd / step) ** 2)
    )
    return float(0.5 * (size**2).sum())


def noise_of_readings(
    parts: Sequence[tuple[Array, Array, Array]], reading: Reading
) -> NoiseModel | None:
    """Return the noise of rounded readings: white, plus the part of the rounding that lasts.

    Neighbouring readings of a quantity that hardly moves show the noise before rounding, and the
    quantity itself shows how long the error of rounding lasts. Errors of the model do not matter.

    Parameters
    ----------
    parts : sequence of (t_s, exact, reading), shape (n,) each
        For each stretch: the quantity according to the model, and the readings.

    Returns
    -------
    NoiseModel or None
        None if too few samples are calm.
    """
    step = reading.step
    moved = np.concatenate([np.diff(exact) for _, exact, _ in parts])
    jumped = np.concatenate([np.diff(read) for _, _, read in parts])
    calm = np.abs(moved) < READING_CALM * step
    if calm.sum() < FEWEST_SAMPLES:
        return None
    square = np.square(jumped[calm] - moved[calm])
    for _ in range(3):
        most = 9.0 * max(float(square.mean()), step**2 / 6.0)
        square = square[square < most]
    seen = 0.5 * float(square.mean())

    def excess(noise_sd: float) -> float:
        return noise_sd**2 + step**2 / 12.0 - lasting(noise_sd, step) - seen

    low, high = (share * step for share in NOISE_BY_STEP)
    if excess(high) < 0.0:  # its steps are lost in its noise
        return None
    noise_sd = low if excess(low) > 0.0 else float(brentq(excess, low, high))
    whole = noise_sd**2 + step**2 / 12.0
    if lasting(noise_sd, step) < NEGLIGIBLE * whole:
        return NoiseModel(math.sqrt(whole))
    slow, tau_s = _memory([(t, _mean_error(x, reading, noise_sd)) for t, x, _ in parts])
    slow = min(slow, 0.99 * whole)
    if slow < NEGLIGIBLE * whole:
        return NoiseModel(math.sqrt(whole))
    return NoiseModel(math.sqrt(whole - slow), math.sqrt(slow), tau_s)


def _mean_error(exact: Array, reading: Reading, noise_sd: float) -> Array:
    """Return the mean rounding error at each value of a quantity."""
    turn = 2.0 * math.pi * (exact - reading.origin) / reading.step
    error = np.zeros(len(exact))
    for k in HARMONICS.tolist():
        size = reading.step / (math.pi * k)
        size *= math.exp(-2.0 * (math.pi * k * noise_sd / reading.step) ** 2)
        error += (-1.0) ** k * size * np.sin(k * turn)
    return error


def _memory(parts: Sequence[tuple[Array, Array]]) -> tuple[float, float]:
    """Return variance and correlation time of the part of a series that outlasts a sample."""
    period_s = float(np.median(np.concatenate([np.diff(t) for t, _ in parts])))
    far = max(round(LATER_S / max(period_s, 1e-6)), 3)
    together = []
    for lag in (1, far):
        pairs = [(r[lag:], r[:-lag]) for _, r in parts if len(r) > lag]
        count = sum(len(a) for a, _ in pairs)
        together.append(sum(float(a @ b) for a, b in pairs) / max(count, 1))
    soon, late = together
    if not soon > 0.0:
        return 0.0, 1.0
    late = min(max(late, 1e-3 * soon), 0.999 * soon)
    tau_s = (far - 1) * period_s / math.log(soon / late)
    return soon * math.exp(period_s / tau_s), tau_s
