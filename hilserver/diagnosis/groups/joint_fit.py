"""One model in all groups: each fitted by itself, then together with what they share."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis.decide.settling import Judged
from hilserver.diagnosis.findings.estimate import fitted_covariance, is_wave
from hilserver.diagnosis.groups.sharing import GroupFit, Together, free_parameters, together
from hilserver.diagnosis.regression.fitting import fit
from hilserver.diagnosis.regression.gain import held_out
from hilserver.diagnosis.regression.linear import sandwich
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.thresholds import COMPARE_LEVEL
from hilserver.measured.arrays import Array, Mask

SILENT: Final = 1e-3
"""Whitened size of a cause's least effect below which a log knows nothing of it."""


@dataclass(frozen=True)
class Member:
    """One stage of one group.

    Attributes
    ----------
    run_of_block : ndarray of int64, shape (blocks,)
        The log that each block belongs to.
    """

    group: str
    judged: Judged
    run_of_block: NDArray[np.int64]

    @property
    def problem(self) -> Problem:
        """Its regression."""
        return self.judged.prepared.problem


@dataclass(frozen=True)
class JointFit:
    """A model in all groups.

    Attributes
    ----------
    points : tuple of Point
        Of each group, fitted by itself.
    fits : tuple of GroupFit
        What each group knows by itself.
    all : Together
        Values and covariances with what is shared.
    p : ndarray, shape (k,)
        Of no difference between the groups, all parameters counted.
    """

    members: tuple[Member, ...]
    points: tuple[Point, ...]
    fits: tuple[GroupFit, ...]
    all: Together
    p: Array

    def model(self, group: int) -> Model:
        """Return the model of a group, with what it shares."""
        return _with_values(self.points[group].model, self.all.value[group])

    def held_out(self) -> tuple[Array, ...]:
        """Return every sample's prediction by a fit that did not see its block."""
        folds = []
        for test in (0, 1):
            own = [
                known.with_value(_trained(member.problem, point, test))
                for member, point, known in zip(self.members, self.points, self.fits, strict=True)
            ]
            values = together(own, self.all.free).value
            folds.append([
                member.problem.point(_with_values(point.model, value), point.poses).predicted
                for member, point, value in zip(self.members, self.points, values, strict=True)
            ])  # fmt: skip
        pairs = zip(*folds, strict=True)
        return tuple(
            held_out(member.problem, pair) for member, pair in zip(self.members, pairs, strict=True)
        )


def fit_in_all(members: Sequence[Member], models: Sequence[Model]) -> JointFit:
    """Fit a model in every group and find which of its parameters differ by group."""
    points = _points(members, models)
    fits = [_known(m, p) for m, p in zip(members, points, strict=True)]
    model = points[0].model
    least = np.array([f.candidate.least for f in model.fitted for _ in f.theta])
    free, p = free_parameters(fits, units_of(model), least, COMPARE_LEVEL)
    return JointFit(tuple(members), tuple(points), tuple(fits), together(fits, free), p)


def refitted(members: Sequence[Member], models: Sequence[Model], free: Mask) -> JointFit:
    """Fit a model in every group where it is known what differs."""
    points = _points(members, models)
    fits = [_known(m, p) for m, p in zip(members, points, strict=True)]
    whole = together(fits, free)
    return JointFit(tuple(members), tuple(points), tuple(fits), whole, np.ones(len(free)))


def units_of(model: Model) -> list[tuple[int, ...]]:
    """Return the parameters that are free only together: both parts of a wave."""
    units: list[tuple[int, ...]] = []
    for f, mine in zip(model.fitted, model.slices, strict=True):
        own = tuple(range(mine.start, mine.stop))
        units += [own] if is_wave(f) else [(i,) for i in own]
    return units


def _points(members: Sequence[Member], models: Sequence[Model]) -> list[Point]:
    return [
        fit(member.problem, model, member.judged.point)
        for member, model in zip(members, models, strict=True)
    ]


def _with_values(model: Model, values: Array) -> Model:
    low, high = model.borders()
    return model.with_theta(np.clip(values, low, high))


def _trained(problem: Problem, point: Point, test: int) -> Array:
    """Return the parameters of one group by all of its blocks but those of a fold."""
    train = problem.stack.fold != test
    if not train.any():
        return point.model.theta()
    return fit(problem, point.model, point, rows=train, iterations=3).model.theta()


def _known(member: Member, point: Point) -> GroupFit:
    """Return what the logs of one group know of the parameters of a model.

    Where the estimates of single logs scatter more than their blocks say, the logs count: one log's
    own precision says nothing about the next log.
    """
    problem, model = member.problem, point.model
    columns = problem.accepted(point)
    assert columns is not None
    least = np.array([max(f.candidate.least, abs(s))
                      for f in model.fitted for s in f.candidate.step])  # fmt: skip
    known = np.sqrt((columns**2).sum(axis=0)) * least > SILENT
    k = len(known)
    covariance, dofs = np.zeros((k, k)), np.full(k, 1.0)
    if known.any():
        place = np.ix_(known, known)
        every, dof = fitted_covariance(problem, point, columns)
        own = every[place]
        scatter, logs = _between_logs(member, point, columns[:, known])
        growth = np.sqrt(np.maximum(scatter / np.diag(own), 1.0))
        covariance[place] = own * np.outer(growth, growth)
        dofs[known] = np.where(growth > 1.0, max(logs - 1, 1), dof)
    return GroupFit(model.theta(), known, covariance, dofs)


def _between_logs(member: Member, point: Point, columns: Array) -> tuple[Array, int]:
    """Return the variances of the parameters by the scatter of single logs, and their number."""
    problem = member.problem
    blocks = problem.stack.block_sums(columns * point.left[:, None])
    runs = np.unique(member.run_of_block[np.abs(blocks).sum(axis=1) > 0.0])
    if len(runs) < 2:
        return np.zeros(columns.shape[1]), len(runs)
    sums = np.stack([blocks[member.run_of_block == run].sum(axis=0) for run in runs])
    return np.diag(sandwich(columns, sums)) * len(runs) / (len(runs) - 1), len(runs)
