"""A Gaussian process on the residual velocities of the body: an upper bound that names no cause.

It models them as any smooth function of the replay's speed, turn rate and their derivatives.
"""

import warnings
from typing import Final

import numpy as np
from numpy.typing import NDArray

from benchmarks.body_velocities import AHEAD, TURN, WINDOW, BodyVelocities
from hilserver.arrays import Array
from hilserver.diagnosis.regression.gain import held_out
from hilserver.diagnosis.regression.stages import Prepared

LEARNED_FROM: Final = 300
MOST: Final = 1500
LENGTHS: Final = (1.0, 100.0)
"""Bounds of the kernel's length, in standard deviations of each input."""


def gaussian_process(prepared: Prepared) -> Array:
    """Return the held-out prediction of all samples of a pose."""
    body = BodyVelocities(prepared)
    ahead, turn = body.replayed[AHEAD], body.replayed[TURN]
    inputs = np.stack([ahead, turn, body.rate(ahead), body.rate(turn)], axis=1)
    inputs /= inputs.std(axis=0) + 1e-12
    predictions = []
    for test in (0, 1):
        rows = np.flatnonzero(body.fold != test)
        left = {key: _mean(inputs, values, rows) for key, values in body.left.items()}
        predictions.append(body.predicted(left))
    return held_out(prepared.problem, predictions)


def _mean(inputs: Array, left: Array, rows: NDArray[np.int64]) -> Array:
    """Return the mean of the process at all inputs, given some rows.

    The kernel is learned from rows without common measurements: noise shared by neighbours would
    be taken for structure. The mean uses as many rows as memory allows.
    """
    from sklearn.exceptions import ConvergenceWarning  # noqa: PLC0415 (an extra)
    from sklearn.gaussian_process import GaussianProcessRegressor  # noqa: PLC0415
    from sklearn.gaussian_process.kernels import RBF, ConstantKernel, WhiteKernel  # noqa: PLC0415

    scale = float(left[rows].std()) + 1e-12
    apart = rows[:: max(WINDOW, len(rows) // LEARNED_FROM)]
    smooth = ConstantKernel(1.0, (1e-4, 1e4)) * RBF(2.0, LENGTHS)
    learning = GaussianProcessRegressor(smooth + WhiteKernel(0.5, (1e-4, 10.0)))
    with warnings.catch_warnings():
        # at a bound: nothing more to learn
        warnings.simplefilter("ignore", ConvergenceWarning)
        learning.fit(inputs[apart], left[apart] / scale)
    process = GaussianProcessRegressor(learning.kernel_, optimizer=None)
    rows = rows[:: max(1, -(-len(rows) // MOST))]
    process.fit(inputs[rows], left[rows] / scale)
    return np.asarray(scale * process.predict(inputs))
