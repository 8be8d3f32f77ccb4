"""One model in all groups: each is fitted on its own, then together with what they share."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilserver.arrays import Array, Mask
from hilserver.diagnosis.compare.differences import run_of_spans
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.findings.estimate import is_wave
from hilserver.diagnosis.groups.sharing import (
    GroupFit,
    Together,
    free_parameters,
    together,
)
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import held_out
from hilserver.diagnosis.regression.intervals import whole_covariance
from hilserver.diagnosis.regression.linear import sandwich
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.thresholds import COMPARE_LEVEL, UNSEEN_SD


@dataclass(frozen=True)
class JointFit:
    """A model in all groups."""

    members: tuple[JudgedStage, ...]
    points: tuple[Point, ...]  # of each group, fitted on its own
    fits: tuple[GroupFit, ...]  # what the logs of each group show on their own
    all: Together  # values and covariances, including what is shared

    def model(self, group: int) -> Model:
        """Return the model of a group, including what it shares."""
        return _with_values(self.points[group].model, self.all.value[group])

    def held_out(self, left_out: frozenset[int] = frozenset()) -> tuple[Array, ...]:
        """Return every sample's prediction by a fit that did not see its block.

        Parameters
        ----------
        left_out : frozenset of int
            Causes that were fitted with the others but predict nothing.
        """

        def predicted(j: JudgedStage, point: Point, values: Array) -> Array:
            model = _with_values(point.model, values).without(*left_out)
            return j.prepared.problem.point(model, point.poses).predicted

        folds = []
        for test in (0, 1):
            own = [
                replace(known, value=_trained(j.prepared.problem, point, test))
                for j, point, known in zip(
                    self.members, self.points, self.fits, strict=True
                )
            ]
            values = together(own, self.all.free).value
            folds.append(list(map(predicted, self.members, self.points, values)))
        pairs = zip(*folds, strict=True)
        return tuple(
            held_out(j.prepared.problem, pair)
            for j, pair in zip(self.members, pairs, strict=True)
        )


def fit_in_all(
    members: Sequence[JudgedStage], models: Sequence[Model], free: Mask | None = None
) -> JointFit:
    """Fit a model in every group.

    Parameters
    ----------
    free : ndarray of bool, shape (k,), optional
        The parameters that differ by group; without it they are determined.
    """
    points = [
        fit(j.prepared.problem, model, j.point)
        for j, model in zip(members, models, strict=True)
    ]
    fits = [
        _known(j.prepared.problem, point)
        for j, point in zip(members, points, strict=True)
    ]
    if free is None:
        model = points[0].model
        least = np.array([f.candidate.least for f in model.fitted for _ in f.theta])
        free = free_parameters(fits, units_of(model), least, COMPARE_LEVEL)
    return JointFit(tuple(members), tuple(points), tuple(fits), together(fits, free))


def units_of(model: Model) -> list[tuple[int, ...]]:
    """Return the parameters that can only be free together: both parts of a wave."""
    units: list[tuple[int, ...]] = []
    for f, mine in zip(model.fitted, model.slices, strict=True):
        own = tuple(range(mine.start, mine.stop))
        units += [own] if is_wave(f) else [(i,) for i in own]
    return units


def _with_values(model: Model, values: Array) -> Model:
    low, high = model.borders()
    return model.with_theta(np.clip(values, low, high))


def _trained(problem: Problem, point: Point, test: int) -> Array:
    """Return the parameters of one group, fitted to all of its blocks except those of a fold."""
    train = problem.stack.fold != test
    if not train.any():
        return point.model.theta()
    return fit(problem, point.model, point, rows=train, iterations=3).model.theta()


def _known(problem: Problem, point: Point) -> GroupFit:
    """Return what the logs of one group show of the parameters of a model.

    If the estimates of single logs scatter more than their blocks suggest, the logs count: the
    precision of one log does not tell how far the next log will be off.
    """
    model = point.model
    columns = problem.accepted(point)
    assert columns is not None
    least = np.array([max(f.candidate.least, abs(s))
                      for f in model.fitted for s in f.candidate.step])  # fmt: skip
    known = np.sqrt((columns**2).sum(axis=0)) * least > UNSEEN_SD
    k = len(known)
    covariance, dofs = np.zeros((k, k)), np.full(k, 1.0)
    if known.any():
        place = np.ix_(known, known)
        every, dof = whole_covariance(problem, point, columns)
        own = every[place]
        scatter, logs = _between_logs(problem, point, columns[:, known])
        growth = np.sqrt(np.maximum(scatter / np.diag(own), 1.0))
        covariance[place] = own * np.outer(growth, growth)
        dofs[known] = np.where(growth > 1.0, max(logs - 1, 1), dof)
    return GroupFit(model.theta(), known, covariance, dofs)


def _between_logs(problem: Problem, point: Point, columns: Array) -> tuple[Array, int]:
    """Return the parameters' variances from the scatter of single logs, and the number of logs."""
    stack = problem.stack
    run_of_block = np.full(stack.n_blocks, -1, dtype=np.int64)
    run_of_block[stack.block] = run_of_spans([problem.stage.log])[
        problem.stage.segments.span[stack.segment]
    ]
    blocks = stack.block_sums(columns * point.left[:, None])
    runs = np.unique(run_of_block[np.abs(blocks).sum(axis=1) > 0.0])
    if len(runs) < 2:
        return np.zeros(columns.shape[1]), len(runs)
    sums = np.stack([blocks[run_of_block == run].sum(axis=0) for run in runs])
    return np.diag(sandwich(columns, sums)) * len(runs) / (len(runs) - 1), len(runs)
