"""Velocities of the body from position, heading and gyro: the data for rivals on velocities.

The replay of the configured plant goes through the same smoothing as the measurement, so the
residual velocities contain neither errors of the smoothing nor causes that the plant has.
"""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.signal import savgol_filter

from hilserver.arrays import Array
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.measured.channels import GYRO, POSITION, YAW

STEP_S: Final = 0.05
WINDOW: Final = 21
"""Steps of the grid over which a velocity is smoothed."""
ORDER: Final = 3

AHEAD, ASIDE, TURN, GYRO_TURN = "ahead", "aside", "turn", "gyro"


class BodyVelocities:
    """Residuals of the body's velocities, on a grid of their own, and the replay's motion there.

    Attributes
    ----------
    replayed : mapping of str to ndarray, shape (n,)
        Forward and sideways speed [m/s], turn rate and gyro's rate [rad/s] of the replay.
    left : mapping of str to ndarray, shape (n,)
        Measured minus replayed.
    yaw_rad : ndarray, shape (n,)
        Measured heading, smoothed.
    block, fold : ndarray of int64, shape (n,)
        Block and fold of the nearest sample of the heading.
    """

    def __init__(self, prepared: Prepared) -> None:
        self.problem, self.base = prepared.problem, prepared.base.predicted
        stack = self.problem.stack
        self.names = [n for n in (*POSITION, YAW, GYRO) if n in stack.edges]
        self._kept = self.problem.weights > 0.0  # no outliers
        self._spread()
        measured, replayed = (self._velocities(v) for v in (stack.values, self.base))
        self.replayed = replayed
        self.left = {key: measured[key] - replayed[key] for key in replayed}
        self.yaw_rad = self._smooth(self._heading(stack.values))
        nearest = self._nearest()
        self.block = stack.block[nearest]
        self.fold = stack.fold[self.block]

    def _spread(self) -> None:
        """Lay a grid over the part of each segment that all channels cover."""
        stack, stage = self.problem.stack, self.problem.stage
        step = STEP_S / stage.segments.period_s
        rows, self.parts = [], []
        begin = 0
        for i in range(len(stage.segments)):
            ats = [stack.at[own] for own in self._own(i)]
            if min(map(len, ats)) < 2:
                continue
            low, high = max(at[0] for at in ats), min(at[-1] for at in ats)
            grid = np.arange(low, high, step)
            if len(grid) >= WINDOW:
                rows.append(grid)
                self.parts.append((i, slice(begin, begin + len(grid))))
                begin += len(grid)
        self.at = np.concatenate(rows) if rows else np.empty(0)

    def _own(self, segment: int, *, kept: bool = True) -> list[NDArray[np.int64]]:
        """Return the indices of the samples of a segment, channel by channel."""
        stack, found = self.problem.stack, []
        for name in self.names:
            edge = stack.edges[name]
            mine = stack.segment[edge] == segment
            found.append(
                edge.start + np.flatnonzero(mine & self._kept[edge] if kept else mine)
            )
        return found

    def _sampled(self, name: str, values: Array) -> Array:
        """Return a channel on the grid, its heading unwrapped, its turn rate as an angle."""
        stack, out = self.problem.stack, np.empty(len(self.at))
        for i, part in self.parts:
            own = self._own(i)[self.names.index(name)]
            at, mine = stack.at[own], values[own]
            if name == YAW:
                mine = np.unwrap(mine)
            elif name == GYRO:
                passed_s = np.diff(at) * self.problem.stage.segments.period_s
                turned = np.cumsum(0.5 * (mine[1:] + mine[:-1]) * passed_s)
                mine = np.concatenate([[0.0], turned])
            out[part] = np.interp(self.at[part], at, mine)
        return out

    def _heading(self, values: Array) -> Array:
        return self._sampled(YAW, values)

    def _smooth(self, values: Array, order: int = 0) -> Array:
        out = np.empty_like(values)
        for _, part in self.parts:
            out[part] = savgol_filter(
                values[part], WINDOW, ORDER, deriv=order, delta=STEP_S
            )
        return out

    def rate(self, values: Array) -> Array:
        """Return the smoothed derivative of values on the grid, per second."""
        return self._smooth(values, 1)

    def _velocities(self, values: Array) -> dict[str, Array]:
        x, y = (self.rate(self._sampled(name, values)) for name in POSITION)
        yaw = self._heading(values)
        along = (x + 1j * y) * np.exp(-1j * self._smooth(yaw))
        found = {AHEAD: along.real, ASIDE: along.imag, TURN: self.rate(yaw)}
        if GYRO in self.names:
            found[GYRO_TURN] = self.rate(self._sampled(GYRO, values))
        return found

    def _nearest(self) -> NDArray[np.int64]:
        """Return the sample of the heading nearest to each row of the grid."""
        stack, out = self.problem.stack, np.empty(len(self.at), dtype=np.int64)
        for i, part in self.parts:
            own = self._own(i)[self.names.index(YAW)]
            middle = 0.5 * (stack.at[own][1:] + stack.at[own][:-1])
            out[part] = own[np.searchsorted(middle, self.at[part])]
        return out

    def predicted(self, left: Mapping[str, Array]) -> Array:
        """Return the prediction of all samples from the replay and residual velocities."""
        stack, out = self.problem.stack, self.base.copy()
        velocity = self.replayed[AHEAD] + 1j * self.replayed[ASIDE]
        more = left[AHEAD] + 1j * left[ASIDE]
        heading = self._heading(self.base)
        for i, part in self.parts:
            turned = _integral(left[TURN][part])
            moved = (velocity + more)[part] * np.exp(1j * turned) - velocity[part]
            off = _integral(moved * np.exp(1j * heading[part]))
            shown = {POSITION[0]: off.real, POSITION[1]: off.imag, YAW: turned}
            if GYRO in self.names:
                shown[GYRO] = left[GYRO_TURN][part]
            for name, own in zip(self.names, self._own(i, kept=False), strict=True):
                out[own] += np.interp(stack.at[own], self.at[part], shown[name])
        return out


def _integral(rate: NDArray[Any]) -> NDArray[Any]:
    """Return the trapezoidal integral; of complex numbers, too."""
    total = np.zeros_like(rate)
    total[1:] = np.cumsum(0.5 * (rate[1:] + rate[:-1]) * STEP_S)
    return total
