"""A rival that knows what to look for: `mujoco.sysid`, given the causes that are hidden in a log.

It fits their parameters and the initial poses by least squares, starting at the configured plant,
with the replay of the diagnosis as its model, and gives intervals from its Jacobian. It is given
shapes (a region, a phase). It models no correlated noise, no outliers and no other causes: it shows
what the diagnosis loses by having to choose causes, and what its intervals are worth.
"""

import io
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from hilserver_injector.cases import Case

from benchmarks.diagnose_scoring import Value, bare, value_of
from hilserver.arrays import Array
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.stages import Prepared, prepare_all
from hilserver.errors import FailedError
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.plant.parameters import RobotParameters

POSE_STEP: Final = 0.01
FARTHEST: Final = 1000.0
"""Bound of parameters without one, in steps of the finite differences."""
ROUNDS: Final = 2
MOST_STEPS: Final = 20
PRECISION: Final = 1e-3


def library() -> Any:
    """Return `mujoco.sysid`.

    Raises
    ------
    FailedError
        If it, or a dependency, is not installed.
    """
    try:
        from mujoco import sysid  # noqa: PLC0415 (an extra, slow to import)
    except ImportError:
        sysid = None
    if not hasattr(
        sysid, "calculate_intervals"
    ):  # without its extra it imports, but empty
        raise FailedError(
            "the rivals of the diagnosis need mujoco.sysid: pip install 'hilserver[rivals]'"
        )
    return sysid


def fitted(case: Case, log: MeasuredLog, robot: RobotParameters) -> dict[str, Value]:
    """Return every scored parameter as `mujoco.sysid` fits it; empty if it cannot see them."""
    names = list(case.answer.values)
    causes = {bare(name) for name in names}
    own = machine(log, robot)
    for prepared in prepare_all(check(log, own).log, own, 1, Tracker())[0].values():
        if causes <= {c.cause for c in prepared.library.candidates}:
            fit = Fit(prepared, names, case.recipe.causes)
            return {
                name: value_of(
                    name, case.answer.values[name], value, (value - half, value + half)
                )
                for name, (value, half) in fit.run().items()
            }
    return {}


class Fit:
    """Parameters by name and initial poses, all in steps of their finite differences."""

    def __init__(
        self, prepared: Prepared, names: list[str], known: Mapping[str, float]
    ) -> None:
        self.problem, self.poses, self.names = (
            prepared.problem,
            prepared.base.poses,
            names,
        )
        self.shapes = {
            name: value for name, value in known.items() if name not in names
        }
        self.begin, self.step, low, high = np.zeros((4, len(names)))
        for cause in dict.fromkeys(bare(name) for name in names):
            mine = [k for k, name in enumerate(names) if bare(name) == cause]
            able = [c for c in prepared.library.candidates if c.cause == cause]
            first = able[0]
            self.step[mine] = np.abs(first.step[: len(mine)])
            low[mine], high[mine] = first.low[: len(mine)], first.high[: len(mine)]
            self.begin[mine] = min(
                (c.start[: len(mine)] for c in able), key=self._left_by(mine)
            )
        self.low = np.maximum(low, self.begin - FARTHEST * self.step)
        self.high = np.minimum(high, self.begin + FARTHEST * self.step)

    def _left_by(self, mine: list[int]) -> Any:
        def left(start: tuple[float, ...]) -> float:
            values = dict(zip((self.names[k] for k in mine), start, strict=True))
            white = self.problem.whiten(self._missed(values, self.poses))
            return float(white @ white)

        return left

    def _missed(self, values: Mapping[str, float], poses: Array) -> Array:
        terms = self.shapes | dict(values)
        return self.problem.residual(self.problem.predict(terms, poses))

    def missed(self, x: Array) -> list[Array]:
        """Return the residuals of every channel."""
        n = len(self.names)
        values = dict(zip(self.names, (x[:n] * self.step).tolist(), strict=True))
        missed = self._missed(
            values, self.poses + POSE_STEP * x[n:].reshape(self.poses.shape)
        )
        return [missed[edge] for edge in self.problem.stack.edges.values()]

    def run(self) -> dict[str, tuple[float, float]]:
        """Return value and half width of its 95 % interval by name."""
        sysid, m = library(), self.poses.size
        low = np.concatenate([self.low / self.step, np.full(m, -FARTHEST)])
        high = np.concatenate([self.high / self.step, np.full(m, FARTHEST)])
        x = np.concatenate([self.begin / self.step, np.zeros(m)])
        for _ in range(ROUNDS):  # metres and radians, each scaled by its residual
            rms = [float(np.sqrt(np.mean(part**2))) + 1e-12 for part in self.missed(x)]
            left = Left(self, rms)
            _, result = sysid.optimize(
                sysid.ParameterDict({"x": sysid.Parameter("x", x, low, high)}), left.parts,
                verbose=False, output=io.StringIO(), max_iters=MOST_STEPS, xtol=PRECISION,
                jacobian=left.jacobian,
            )  # fmt: skip
            x = result.x.ravel()
        _, halves = sysid.calculate_intervals([left.of(x)], np.asarray(result.jac))
        found = zip(self.names, x, halves, self.step, strict=False)
        return {
            name: (float(v * step), float(half * step)) for name, v, half, step in found
        }


@dataclass
class Left:
    """Residuals in the form that `mujoco.sysid` needs: each channel divided by its scale."""

    fit: Fit
    scales: list[float]

    def of(self, x: Array) -> Array:
        """Return all residuals, shape (n,)."""
        missed = self.fit.missed(x.ravel())
        return np.concatenate(
            [p / scale for p, scale in zip(missed, self.scales, strict=True)]
        )

    def parts(self, x: Array, _: object) -> tuple[list[Array], None, None]:
        """Return the residuals as a column; the other two values are for its reports."""
        return [self.of(x)[:, None]], None, None

    def jacobian(self, x: Array, r: Array) -> Array:
        """Return forward differences over one step: delays and steps permit no smaller ones."""
        ahead = [self.of(x.ravel() + row)[:, None] - r for row in np.eye(x.size)]
        return np.concatenate(ahead, axis=1)
