"""Coloured measurement noise, and the linear operator that makes it white.

One channel's noise is white plus an Ornstein-Uhlenbeck process: ``r_k = x(t_k) + e_k`` with
``cov(x(t), x(s)) = ou_sd^2 exp(-|t - s| / ou_tau_s)``. Its Kalman filter turns samples at any
stamps into independent innovations of variance 1, in one pass. The gains depend on stamps and
weights alone, so a residual and its sensitivities pass through the same linear operator.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hilserver.arrays import Array
from hilserver.compiled import kernel


@dataclass(frozen=True, slots=True)
class NoiseModel:
    """Noise of one channel: white + Ornstein-Uhlenbeck, with tails."""

    # standard deviations, in the unit of the channel; either may be 0
    white_sd: float
    ou_sd: float = 0.0
    ou_tau_s: float = 1.0  # correlation time of the Ornstein-Uhlenbeck part
    # of the innovations' Student-t distribution; infinite: normal
    tail_dof: float = math.inf

    @property
    def sd(self) -> float:
        """Standard deviation of one sample."""
        return math.hypot(self.white_sd, self.ou_sd)


@dataclass(frozen=True)
class Filter:
    """The Kalman filters of successive stretches: what each does at every sample."""

    # shape (n,): share of the level that remains since the last sample, 0 where a stretch begins;
    # share of an innovation that the level takes up; whitened sample per innovation, 0: skipped
    keep: Array
    gain: Array
    scale: Array

    @classmethod
    def empty(cls, n: int) -> "Filter":
        """Return the filters of `n` samples, to be filled by `prepare`."""
        return cls(np.zeros(n), np.zeros(n), np.zeros(n))

    def prepare(
        self, part: slice, model: NoiseModel, t_s: Array, weights: Array
    ) -> None:
        """Fill in the filter for one stretch of noise.

        Parameters
        ----------
        t_s : ndarray, shape (n,)
            Stamps of all samples, not decreasing within the stretch. Gaps are missing samples.
        weights : ndarray, shape (n,)
            Of each sample, at least 0. A sample of weight 0 is skipped: output 0, no trace in the
            later ones. Weight w multiplies the variance of its innovation by 1/w.

        Raises
        ------
        ValueError
            If both standard deviations of the noise are 0, or one is NaN.
        """
        if not (model.sd > 0.0 and math.isfinite(model.sd) and model.ou_tau_s > 0.0):
            raise ValueError(f"no noise to whiten with: {model}")
        if model.ou_sd == 0.0:
            self.scale[part] = np.sqrt(weights[part]) / model.white_sd
            return
        variances = model.white_sd**2, model.ou_sd**2, model.ou_tau_s
        places = self.keep[part], self.gain[part], self.scale[part]
        fill_gains(t_s[part], weights[part], *variances, *places)

    def whiten(self, columns: Array) -> Array:
        """Whiten columns, shape (n,) or (n, k): each passes through the same linear operator."""
        table = np.ascontiguousarray(
            columns if columns.ndim > 1 else columns[:, None], float
        )
        if not self.gain.any():  # already white
            white = table * self.scale[:, None]
            white[self.scale == 0.0] = 0.0  # whatever the value, even NaN
            return white.reshape(np.shape(columns))
        out = np.empty_like(table)
        filter_columns(table, self.keep, self.gain, self.scale, out)
        return out.reshape(np.shape(columns))


@kernel()
def fill_gains(
    t_s: Any,
    weights: Any,
    white: float,
    ou: float,
    tau_s: float,
    kept: Any,
    gain: Any,
    scale: Any,
) -> None:
    """Run the variances of the Kalman filter over one span.

    `white` and `ou` are variances. The state is the Ornstein-Uhlenbeck process, stationary at the
    first sample.
    """
    variance, step, keep = ou, 0.0, 1.0
    kept[:] = 0.0
    for i in range(len(t_s)):
        if i > 0:
            if t_s[i] - t_s[i - 1] != step:
                step = t_s[i] - t_s[i - 1]
                keep = math.exp(-step / tau_s)
            variance = ou + keep * keep * (variance - ou)
            kept[i] = keep
        weight = weights[i]
        if not weight > 0.0:
            gain[i], scale[i] = 0.0, 0.0
            continue
        innovation = max(variance + white, 1e-12 * ou)
        gain[i] = weight * variance / innovation
        scale[i] = math.sqrt(weight / innovation)
        variance *= max(1.0 - gain[i], 0.0)


@kernel()
def filter_columns(columns: Any, keeps: Any, gains: Any, scales: Any, out: Any) -> None:
    """Run the levels of the Kalman filters over all columns."""
    n, width = columns.shape
    level = np.zeros(width)
    for i in range(n):
        keep, gain, scale = keeps[i], gains[i], scales[i]
        for j in range(width):
            before = keep * level[j]
            surprise = columns[i, j] - before if scale > 0.0 else 0.0
            out[i, j] = scale * surprise
            level[j] = before + gain * surprise
