"""Simple rivals of the diagnosis: the same wheel speeds, folds and metric, no selection of causes.

Each returns the held-out prediction of all samples of a pose, for `regression.gain`.
"""

import itertools
from collections.abc import Callable, Mapping
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.gaussian_process import gaussian_process
from benchmarks.sindy import sindy
from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import (
    HORIZON_S,
    held_out,
    missed,
    of_halves,
    windows,
)
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.measured.channels import GYRO, POSITION, YAW

MOST_CAUSES: Final = 8
TRIED: Final = 3
"""Candidates that a round of `stepwise` fits: those with the largest linear gains."""
MOST_RUNS: Final = 40


def applies(problem: Problem) -> bool:
    """Return whether the rivals can be compared on a stage: position and heading were measured."""
    return isinstance(problem.stage, PoseStage) and problem.stage.log.has(
        *POSITION, YAW
    )


class NineTerms:
    """Eight terms and one delay of the navigation, by least squares of the pose.

    Forward speed, sideways speed and turn rate of the body are linear in the wheels' speed v and
    turn om: scale, rotation gain, both cross terms, the centre of rotation, and the products
    v |om|, v om and |v| om, which are the same for left and right.
    """

    NULL: Final = (1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0)

    def __init__(self, problem: Problem) -> None:
        assert isinstance(problem.stage, PoseStage)
        self.stage, self.stack, stage = problem.stage, problem.stack, problem.stage
        # the sides are sums of two wheels
        per_rpm = stage.robot.wheel_radius_m * np.pi / 60.0
        left, right = stage.left * per_rpm, -stage.right * per_rpm
        self.v, self.om = 0.5 * (left + right), stage.robot.k_om * (right - left)
        self.fold = self.stack.fold[self.stack.block]

    def predict(self, theta: Array) -> Array:
        """Return what the sensors show; each segment begins at the origin."""
        v, om = self.v, self.om
        ahead = theta[0] * v + theta[1] * om + theta[2] * v * np.abs(om)
        aside = theta[3] * om + theta[4] * v * om
        turn = theta[5] * om + theta[6] * v + theta[7] * np.abs(v) * om
        yaw = self._integral(turn)
        place = self._integral((ahead + 1j * aside) * np.exp(1j * yaw))
        out = np.zeros(len(self.stack))
        sources = {
            POSITION[0]: place.real,
            POSITION[1]: place.imag,
            YAW: yaw,
            GYRO: turn,
        }
        for name, source in sources.items():
            if name in self.stack.edges:
                late_s = 0.0 if name == GYRO else theta[8]
                out[self.stack.edges[name]] = self._sampled(source, name, late_s)
        return out

    def _integral(self, rate: NDArray[Any]) -> NDArray[Any]:
        """Return the trapezoidal integral over each segment; of complex numbers, too."""
        total = np.zeros_like(rate)
        np.cumsum(0.5 * (rate[1:] + rate[:-1]) * self.stage.period_s, out=total[1:])
        first = self.stage.segments.first
        return np.asarray(total - np.repeat(total[first[:-1]], np.diff(first)))

    def _sampled(self, source: Array, name: str, late_s: float) -> Array:
        edge = self.stack.edges[name]
        at = self.stack.at[edge] - late_s / self.stage.period_s
        at = np.clip(at, self.stack.low[edge], self.stack.high[edge])
        return np.asarray(np.interp(at, np.arange(len(source)), source))

    def missed(self, predicted: Array) -> tuple[Array, Array]:
        """Return the residuals of position (both coordinates) and yaw, with free initial poses."""
        stack, values = self.stack, self.stack.values
        x, y, yaw = (stack.edges[name] for name in (*POSITION, YAW))
        owner = stack.segment[yaw]
        turn = values[yaw] - predicted[yaw]
        first = turn[np.searchsorted(owner, owner)]
        turn = first + np.angle(np.exp(1j * (turn - first)))
        heading = _mean(turn, owner, len(self.stage.segments))
        own = stack.segment[x]
        moved = (predicted[x] + 1j * predicted[y]) * np.exp(1j * heading[own])
        off = values[x] + 1j * values[y] - moved
        off -= _mean(off, own, len(self.stage.segments))[own]
        return np.concatenate([off.real, off.imag]), turn - heading[owner]

    def fitted(self, test: int | None = None) -> Array:
        """Return the nine values, fitted to all samples or to those outside one fold."""
        x, y, yaw = (self.stack.edges[name] for name in (*POSITION, YAW))
        own = [
            np.concatenate([self.fold[x], self.fold[y]]) != test,
            self.fold[yaw] != test,
        ]
        theta = np.array(self.NULL)
        for _ in range(2):  # metres and radians, each scaled by its residual
            scales = [
                _rms(m[k])
                for m, k in zip(self.missed(self.predict(theta)), own, strict=True)
            ]

            def residual(theta: Array, scales: list[float] = scales) -> Array:
                parts = zip(self.missed(self.predict(theta)), own, scales, strict=True)
                return np.concatenate(
                    [missed[keep] / scale for missed, keep, scale in parts]
                )

            theta = least_squares(residual, theta, max_nfev=MOST_RUNS).x
        return np.asarray(theta)


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) + 1e-12


def _mean(values: NDArray[Any], owner: NDArray[np.int64], n: int) -> NDArray[Any]:
    """Return the mean of each owner's values; of complex numbers, too."""
    total = np.zeros(n, dtype=values.dtype)
    np.add.at(total, owner, values)
    return np.asarray(total / np.maximum(np.bincount(owner, minlength=n), 1))


def nine_terms(prepared: Prepared) -> Array:
    """Return the held-out prediction of `NineTerms`."""
    rival = NineTerms(prepared.problem)
    return held_out(
        prepared.problem, [rival.predict(rival.fitted(test)) for test in (0, 1)]
    )


class EndErrors(NineTerms):
    """The same terms, fitted to the measure of the gain: the error at the end of free runs."""

    BY_M: Final = 0.05
    BY_RAD: Final = 0.05
    LARGEST: Final = 3.0
    LATEST_S: Final = 0.69
    F_SCALE: Final = 2.0
    STARTS: Final = tuple(itertools.product((1.0, 0.5), (0.05, 0.3)))
    """Factor of the turn, and delay in seconds."""

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        runs = windows(problem, HORIZON_S)
        assert runs is not None
        self.problem, self.runs = problem, runs

    def fitted(self, test: int | None = None) -> Array:
        """Return the nine values, fitted to the runs outside one half."""
        start, end, edge = (
            self.runs.start[YAW],
            self.runs.end[YAW],
            self.stack.edges[YAW],
        )
        half = self.stack.half[self.stack.block[edge]]
        keep = (half[start] != test) & (half[end] != test)

        def residual(theta: Array) -> Array:
            off = missed(self.problem, self.predict(theta), self.runs)
            move, turn = off["position_m"], off["yaw_rad"]
            parts = move.real / self.BY_M, move.imag / self.BY_M, turn / self.BY_RAD
            return np.concatenate([part[keep] for part in parts])

        most = np.full(len(self.NULL), self.LARGEST)
        bounds = np.append(-most[:-1], 0.0), np.append(most[:-1], self.LATEST_S)
        best = min(
            (
                least_squares(
                    residual,
                    (*self.NULL[:5], factor, *self.NULL[6:8], delay_s),
                    bounds=bounds,
                    loss="soft_l1",
                    f_scale=self.F_SCALE,
                    max_nfev=MOST_RUNS,
                )
                for factor, delay_s in self.STARTS
            ),
            key=lambda found: float(found.cost),
        )
        return np.asarray(best.x)


def nine_terms_by_end(prepared: Prepared) -> Array:
    """Return the held-out prediction of `EndErrors`."""
    rival = EndErrors(prepared.problem)
    return of_halves(
        prepared.problem, [rival.predict(rival.fitted(test)) for test in (0, 1)]
    )


def stepwise(prepared: Prepared) -> Array:
    """Return the held-out prediction of causes added one by one by Schwarz's criterion (BIC).

    It treats all samples as independent, and tests neither significance nor rival causes.
    """
    problem = prepared.problem
    return held_out(problem, [_stepwise(prepared, test).predicted for test in (0, 1)])


def _stepwise(prepared: Prepared, test: int) -> Point:
    problem, point = prepared.problem, prepared.base
    rows = problem.stack.fold != test
    n = int(rows[problem.stack.block].sum())

    def criterion(trial: Point) -> float:
        parameters = sum(f.candidate.weight for f in trial.model.fitted)
        return float(n * np.log(trial.loss[rows].sum() / n) + parameters * np.log(n))

    while len(point.model.fitted) < MOST_CAUSES:
        trials = [
            fit(
                problem,
                point.model.plus(c, c.beginning),
                point,
                rows=rows,
                iterations=4,
            )
            for c in _most_promising(prepared, point, rows)
        ]
        best = min(trials, key=criterion, default=point)
        if criterion(best) >= criterion(point):
            break
        point = best
    return point


def _most_promising(
    prepared: Prepared, point: Point, rows: NDArray[np.bool_]
) -> list[Candidate]:
    """Return the candidates that would reduce the loss most if linear, one of each cause."""
    library, order = prepared.library, prepared.library.blocks.order
    keep = rows[prepared.problem.stack.block][order]
    columns, left = library.columns[keep], point.left[order][keep].astype(np.float32)
    saved = (columns.T @ left) ** 2 / (np.einsum("ij,ij->j", columns, columns) + 1e-12)
    found: dict[str, Candidate] = {}
    for j in np.argsort(-saved):
        c = library.candidates[library.owner[j]]
        if c.cause not in point.model.causes:
            found.setdefault(c.cause, c)
        if len(found) == TRIED:
            break
    return list(found.values())


RIVALS: Final[Mapping[str, Callable[[Prepared], Array]]] = {
    "nine terms": nine_terms,
    "nine terms, end errors": nine_terms_by_end,
    "stepwise": stepwise,
    "PySINDy": sindy,
    "Gaussian process": gaussian_process,
}
"""`sindy` and `gaussian_process` need the extra ``rivals``."""
