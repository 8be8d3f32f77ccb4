"""The noise of one channel, fitted to residuals that may hold outliers and slow misfits.

The samples are cut into windows of at most 12 s, each with a free level and slope, so that slow
drift (an error of the model) does not count as noise. Variances and correlation time maximise the
exact restricted likelihood (REML) of the windows; gross outliers are left out by their innovation.
"""

import math
from collections.abc import Iterable, Sequence

import numpy as np
from scipy.optimize import minimize
from scipy.special import gammaln

from hilserver.arrays import Array
from hilserver.diagnosis.noise.whitening import NoiseModel
from hilserver.diagnosis.noise.windows import SAMPLES_MAX, NoiseWindows
from hilserver.diagnosis.thresholds import (
    LASTING_TAU_MAX_S,
    NOISE_GATED_MAX,
    NOISE_NATS,
    NOISE_TAU_MAX_S,
    NOISE_WINDOW_S,
    SHORT_DOF,
)
from hilserver.measured.thresholds import LONGEST_SEGMENT_S

_SHARE_LOGITS = (-4.0, -2.0, 0.0, 2.0, 5.0)
_LOGIT_RANGE = (-8.0, 10.0)
_DOFS = (2.1, 2.5, 3.0, 4.0, 5.0, 6.0, 8.0, 11.0, 15.0, 25.0)
_FALLBACK_SD = 1e-9
_LAGS = 40


def fit_noise(
    residuals: Iterable[tuple[Array, Array]], *, lasts: bool = False
) -> NoiseModel:
    """Fit white + Ornstein-Uhlenbeck noise with tails.

    Residuals of a perfect replay, which are all equal, have next to no noise. With fewer than 8
    samples noise cannot be separated, so all of it counts as noise.

    Parameters
    ----------
    residuals : iterable of (t_s, r)
        Per span, shape (n,) each; stamps rise, at any intervals.
    lasts : bool
        Whether the noise itself may be slow drift, as that of satellites: then whole segments are
        the windows.
    """
    residuals = list(residuals)
    window_s, slowest_s = NOISE_WINDOW_S, NOISE_TAU_MAX_S
    if lasts:
        window_s, slowest_s = LONGEST_SEGMENT_S, LASTING_TAU_MAX_S
    windows = NoiseWindows.cut(residuals, window_s)
    if windows.samples < 8:
        return NoiseModel(_size([r for _, r in residuals]))
    if not windows.spread > _FALLBACK_SD:
        return NoiseModel(_FALLBACK_SD)
    windows.gate_level()
    model = _fit(windows, None, slowest_s)
    if windows.gate_innovations(model) > NOISE_GATED_MAX:
        windows.gate_level()
    else:
        model = _fit(windows, model, slowest_s)
    dof = _tail_dof(windows.innovations(model))
    return NoiseModel(
        max(model.white_sd, _FALLBACK_SD), model.ou_sd, model.ou_tau_s, dof
    )


def short_noise(residuals: Sequence[Array]) -> tuple[NoiseModel, float]:
    """Return white noise with the information of the residuals of short segments, and their scale.

    In a segment of a second or two, slow noise looks like the model's own error: a fitted
    correlation would swallow the effect that is looked for. So the samples count as white, with
    the scale of Student's t, and their variance is raised by as much as their correlation lowers
    the effective number of samples.

    Parameters
    ----------
    residuals : sequence of ndarray
        Per segment.

    Returns
    -------
    NoiseModel
    float
        Scale of a sample, for `robust_weights`; 0 if all are equal and count alike.
    """
    square = np.square(np.concatenate(residuals)) if residuals else np.zeros(0)
    if len(square) < 8 or not square.max() > 0.0:
        sd = _size(residuals)
        return NoiseModel(sd), sd if sd > _FALLBACK_SD else 0.0
    scale = float(np.mean(square))
    for _ in range(20):
        scale = float(
            np.mean(square * (SHORT_DOF + 1.0) / (SHORT_DOF + square / scale))
        )
    sd = max(math.sqrt(scale), _FALLBACK_SD)
    bounded = [np.clip(r / sd, -3.0, 3.0) for r in residuals]
    power = sum(float(r @ r) for r in bounded)
    total = 1.0
    for lag in range(1, _LAGS):
        together = (
            sum(float(r[lag:] @ r[:-lag]) for r in bounded if len(r) > lag) / power
        )
        if together < 0.05:
            break
        total += 2.0 * together
    return NoiseModel(sd * math.sqrt(total), tail_dof=SHORT_DOF), sd


def _size(residuals: Sequence[Array]) -> float:
    """Return the root mean square of the finite values, above 0."""
    values = np.concatenate([np.zeros(0), *residuals])
    values = values[np.isfinite(values)]
    return max(
        float(np.linalg.norm(values)) / math.sqrt(max(len(values), 1)), _FALLBACK_SD
    )


def robust_weights(samples: Array) -> Array:
    """Return the weights of Student's t distribution for samples of short segments.

    With ``(dof + 1) / (dof - 2 + z^2)`` the weighted samples have variance 1 again, and none counts
    for more than about ``sqrt(dof + 1)`` standard deviations.

    Parameters
    ----------
    samples : ndarray
        Divided by their scale, see `short_noise`.
    """
    return np.asarray((SHORT_DOF + 1.0) / (SHORT_DOF - 2.0 + np.square(samples)))


def _fit(
    windows: NoiseWindows, start: NoiseModel | None, slowest_s: float
) -> NoiseModel:
    """Maximise the likelihood over correlation time and share of the coloured part."""
    tau_range = (
        math.log(min(windows.step_s, 0.5 * slowest_s)),
        math.log(slowest_s),
    )

    def loss(point: Sequence[float], subset: NoiseWindows = windows) -> float:
        log_tau = min(max(point[0], tau_range[0]), tau_range[1])
        logit = min(max(point[1], _LOGIT_RANGE[0]), _LOGIT_RANGE[1])
        outside = abs(point[0] - log_tau) + abs(point[1] - logit)
        share = 1.0 / (1.0 + math.exp(-logit))
        value, sd = subset.likelihood(1.0 - share, share, math.exp(log_tau))
        # An Ornstein-Uhlenbeck part larger than the residuals themselves is a random walk.
        excess = max(0.0, math.log(sd * math.sqrt(share) / windows.level_sd / 1.5))
        return -value + 10.0 * outside + 1e3 * excess

    if start is None or start.ou_sd == 0.0:
        thin = windows.thinned(SAMPLES_MAX // 3)
        taus = np.linspace(*tau_range, 7)
        grid = [(float(tau), logit) for tau in taus for logit in _SHARE_LOGITS]
        first = min(grid, key=lambda point: loss(point, thin))
    else:
        logit = 2.0 * math.log(start.ou_sd / max(start.white_sd, 1e-5 * start.ou_sd))
        first = (math.log(start.ou_tau_s), logit)
    simplex = np.array([first, (first[0] + 0.4, first[1]), (first[0], first[1] + 0.7)])
    options = {"initial_simplex": simplex, "xatol": 0.01, "fatol": 0.02, "maxfev": 80}
    best = minimize(loss, simplex[0], method="Nelder-Mead", options=options)
    white, white_sd = windows.likelihood(1.0, 0.0, 1.0)
    if -best.fun - white < 2.0 * NOISE_NATS:  # deviation and correlation time
        return NoiseModel(white_sd)
    tau_s = math.exp(min(max(best.x[0], tau_range[0]), tau_range[1]))
    share = 1.0 / (
        1.0 + math.exp(-min(max(best.x[1], _LOGIT_RANGE[0]), _LOGIT_RANGE[1]))
    )
    sd = windows.likelihood(1.0 - share, share, tau_s)[1]
    return NoiseModel(sd * math.sqrt(1.0 - share), sd * math.sqrt(share), tau_s)


def _tail_dof(innovations: Array) -> float:
    """Return the degrees of freedom of maximum likelihood, at any scale; infinite if normal."""
    square = np.square(innovations[innovations != 0.0][:SAMPLES_MAX])
    if len(square) < 50:
        return math.inf
    normal = -0.5 * len(square) * (math.log(2.0 * math.pi * float(square.mean())) + 1.0)
    best, dof = normal + NOISE_NATS, math.inf
    for candidate in _DOFS:
        value = _student_likelihood(square, candidate)
        if value > best:
            best, dof = value, candidate
    return dof


def _student_likelihood(square: Array, dof: float) -> float:
    """Return the log likelihood of Student's t at the best scale (found by EM)."""
    scale = float(np.median(square)) / 0.5
    for _ in range(20):
        scale = float(np.mean(square * (dof + 1.0) / (dof + square / scale)))
    constant = (
        gammaln(0.5 * (dof + 1.0)) - gammaln(0.5 * dof) - 0.5 * math.log(dof * math.pi)
    )
    tails = 0.5 * (dof + 1.0) * np.log1p(square / (dof * scale))
    return float(len(square) * (constant - 0.5 * math.log(scale)) - tails.sum())
