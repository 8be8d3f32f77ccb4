"""What a disturbance of the body's velocity does to the channels of the pose."""

from collections.abc import Mapping
from itertools import pairwise

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.measured.channels import GYRO, POSITION, YAW

GRID_S = 0.02


class Motion:
    """Dense motion of the current model on a coarse grid, and the columns of a disturbance."""

    def __init__(self, stage: PoseStage, problem: Problem, point: Point) -> None:
        self.stage = stage
        stride = max(round(GRID_S / stage.period_s), 1)
        self.problem, self.stride = problem, stride
        dense = stage.simulate(point.model.terms, point.poses)
        self.dt = stage.period_s * stride
        first = stage.segments.first
        self.rows = [
            np.arange(first[i], first[i + 1], stride) for i in range(len(first) - 1)
        ]
        take = np.concatenate(self.rows)
        sizes = [len(r) for r in self.rows]
        self.bounds = np.concatenate([[0], np.cumsum(sizes)])
        self.x, self.y, self.yaw, self.om = (dense[take, c] for c in range(4))
        left, right = stage.left[take], stage.right[take]
        self.v, self.vy = stage.forward_m_s()[take], stage.lateral_m_s[take]
        self._ahead = np.exp(1j * self.yaw)
        self._velocity = (self.v + 1j * self.vy) * self._ahead
        self.t = np.concatenate([
            stage.segments.start_s[i] - stage.segments.lead_s + stage.period_s * (r - first[i])
            for i, r in enumerate(self.rows)
        ])  # fmt: skip
        self.moving = np.tanh((np.abs(left) + np.abs(right)) / 10.0) ** 2
        stack = problem.stack
        local = (stack.at - first[stack.segment]) / self.stride
        last = np.diff(self.bounds)[stack.segment] - 1.0
        self.at = self.bounds[stack.segment] + np.clip(local, 0.0, last)

    def column(self, dv: Array, dvy: Array, dom: Array) -> Array:
        """Return the raw column of a disturbance of the body velocity."""
        yaw = self._integrate(dom)
        place = self._integrate(
            (dv + 1j * dvy) * self._ahead + 1j * yaw * self._velocity
        )
        return self._sampled(
            {POSITION[0]: place.real, POSITION[1]: place.imag, YAW: yaw, GYRO: dom}
        )

    def ahead(self, d: Array) -> Array:
        """Return the raw column of a disturbance of the speed ahead."""
        return self.column(d, np.zeros_like(d), np.zeros_like(d))

    def aside(self, d: Array) -> Array:
        """Return the raw column of a disturbance of the speed to the side."""
        return self.column(np.zeros_like(d), d, np.zeros_like(d))

    def turn(self, d: Array) -> Array:
        """Return the raw column of a disturbance of the turn rate."""
        return self.column(np.zeros_like(d), np.zeros_like(d), d)

    def _sampled(self, sources: Mapping[str, Array]) -> Array:
        """Return what channels show of signals on the grid; other channels show nothing."""
        out = np.zeros(len(self.problem.stack))
        for name, edge in self.problem.stack.edges.items():
            if name not in sources:
                continue
            source, at = sources[name], self.at[edge]
            low = np.minimum(at.astype(np.int64), len(source) - 1)
            high = np.minimum(low + 1, len(source) - 1)
            out[edge] = source[low] + (at - low) * (source[high] - source[low])
        return out

    def placed(self, dx: Array, dy: Array) -> Array:
        """Return the raw column of an offset of the measured position."""
        return self._sampled({POSITION[0]: dx, POSITION[1]: dy})

    def _integrate(self, rate: Array) -> Array:
        total = np.cumsum(rate) * self.dt
        begin = self.bounds[:-1]
        offset = total[begin]
        return np.asarray(total - np.repeat(offset, np.diff(self.bounds)))

    def last_side(self, signal: Array, least: float) -> Array:
        """Return the side that a signal was last clearly on, +1 or -1; +1 at a segment's start."""
        out = np.ones_like(signal)
        for a, b in pairwise(self.bounds.tolist()):
            clear = np.flatnonzero(np.abs(signal[a:b]) > least)
            if not len(clear):
                continue
            latest = np.searchsorted(clear, np.arange(b - a), side="right") - 1
            out[a:b] = np.sign(signal[a:b][clear[np.maximum(latest, 0)]])
        return out

    def smoothed(self, signal: Array, tau_s: float) -> Array:
        """Return a signal's recent past: low-passed within each segment."""
        from scipy.signal import lfilter  # noqa: PLC0415 (slow to import)

        keep = float(np.exp(-self.dt / tau_s))
        out = np.empty_like(signal)
        for a, b in zip(self.bounds[:-1], self.bounds[1:], strict=True):
            out[a:b] = lfilter([1.0 - keep], [1.0, -keep], signal[a:b])
        return out
