"""Which causes marks show: a search on few numbers, whose independent units are whole runs.

A cause is accepted if it lowers the squared misses by more than chance (F test) and the runs agree
on it (t test of their scores), each at 0.1 % over the whole library. The first test trusts the
marks' standard deviations as far as the best fit of all causes allows, the second trusts nothing.
Every model is fitted before it is compared: wheels that differ by 2 % bend a square of 2 m so much
that nothing about it is linear any more.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Final

import numpy as np
from scipy import stats
from scipy.optimize import least_squares

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.decide.trial import implausible, worth_a_name
from hilserver.diagnosis.marks.runs import MarkedRuns, rows_of
from hilserver.diagnosis.marks.slip import RandomSlip
from hilserver.diagnosis.regression.intervals import limits
from hilserver.diagnosis.regression.linear import (
    covariance,
    orthogonal,
    scaled,
)
from hilserver.diagnosis.replay.model import Fitted, Model

BY_CHANCE: Final = 0.001
FEWEST_MARKED_RUNS: Final = 6
FEWEST_FREEDOM: Final = 4  # beyond the causes themselves
MOST_CAUSES: Final = 4
MOST_FIT_STEPS: Final = 40
FIT_EXACT: Final = 1e-6  # relative change at which a fit ends
# a rival that fits worse by less than this, in variances, cannot be excluded: 1 % of a chi-square
RIVAL: Final = 6.63
SIZE: Final = "wheel_radius"
LARGEST_SHOWN: Final = {
    # a smaller robot makes everything smaller that its wheels have slipped
    SIZE: 0.1,
    "wheel_radius_difference": 0.3,
    "rotation_gain": 0.3,
    # [m], [rad]: what closes a square hides them
    "icr_offset": 0.05,
    "wheel_misalignment": 0.05,
}
"""A cause is not sought if it would have to be larger than this to be found."""
SMALLEST_SHARE: Final = 1e-6  # of a cause's column that others leave; less is their sum


@dataclass(frozen=True)
class MarksTrial:
    """A model, its misses and what each cause would change about them.

    Attributes
    ----------
    missed : ndarray, shape (rows,)
        Of unit variance and without correlation.
    effects : ndarray, shape (rows, candidates)
        Change of the misses per unit of each candidate, with the sign of an explanation.
    """

    model: Model
    missed: Array
    effects: Array

    @property
    def deviance(self) -> float:
        """Sum of the squared misses."""
        return float(self.missed @ self.missed)


@dataclass(frozen=True)
class RunScatter:
    """How far runs end from where the best fit of all causes puts them."""

    slip_m: float  # variance of a wheel's distance per metre, see `RandomSlip`
    variance: float  # of what slip and the marks' standard deviations leave, at least 1
    freedom: int


@dataclass(frozen=True)
class MarksSearch:
    """The search on some of the runs."""

    runs: MarkedRuns
    slip: RandomSlip
    candidates: Sequence[Candidate]
    chosen: Indices  # the runs that take part
    report: Callable[[str, float], None] = field(default=lambda *_: None)

    @property
    def rows(self) -> Mask:
        """Which rows take part."""
        return rows_of(self.runs, self.chosen)

    @cached_property
    def scatter(self) -> RunScatter:
        """What no cause explains.

        It is judged where all causes together fit best. Seen from the configured robot, a wrong
        dimension that bends the runs would look like slip.
        """
        joint = Model()
        for candidate in self.candidates:
            if candidate.cause != SIZE:
                joint = joint.plus(candidate, candidate.null)
        joint = self.fit(joint, slip_m=0.0)

        missed = self.runs.residual(joint.terms)
        effects = self._effects(joint, self.candidates)
        mine = self.rows
        explaining = self._explaining(missed * mine, effects * mine[:, None])
        slip_m = self.slip.estimate(missed, explaining, self.chosen)

        missed, effects = (
            self.slip.whitened(one, slip_m)[mine] for one in (missed, effects)
        )
        explaining = self._explaining(missed, effects)
        left = orthogonal(missed, explaining)
        freedom = int(self.runs.freedom[self.chosen].sum()) - explaining.shape[1]
        variance = float(left @ left) / max(freedom, 1)
        return RunScatter(slip_m, max(1.0, variance), freedom)

    def trial(self, model: Model) -> MarksTrial:
        """Evaluate a model."""
        effects = self._effects(model, self.candidates)
        effects = self.slip.whitened(effects, self.scatter.slip_m)[self.rows]
        return MarksTrial(model, self._missed(model), effects)

    def _missed(self, model: Model) -> Array:
        full = self.runs.residual(model.terms)
        return self.slip.whitened(full, self.scatter.slip_m)[self.rows]

    def _effects(self, model: Model, causes: Sequence[Candidate]) -> Array:
        """Return what each of some causes would change about the misses, shape (rows, causes)."""
        missed, columns = self.runs.residual(model.terms), []
        own = {f.candidate.cause: f.theta[0] for f in model.fitted}
        for candidate in causes:
            value = own.get(candidate.cause, candidate.null[0])
            moved = model.plus(candidate, (value + candidate.step[0],))
            change = missed - self.runs.residual(moved.terms)
            columns.append(change / candidate.step[0])
        return np.stack(columns, axis=1)

    def fit(self, model: Model, slip_m: float | None = None) -> Model:
        """Return a model with the parameters that meet the marks best."""
        if not model.fitted:
            return model
        causes = [f.candidate for f in model.fitted]
        slip_m = self.scatter.slip_m if slip_m is None else slip_m
        self.report(f"marks: fit of {causes[-1].label}", len(causes) / MOST_CAUSES)

        # what the marks hardly show stays small
        largest = np.array([LARGEST_SHOWN[one.cause] for one in causes])

        def missed(theta: Array) -> Array:
            full = self.runs.residual(model.with_theta(theta).terms)
            white = self.slip.whitened(full, slip_m)[self.rows]
            return np.concatenate([white, theta / largest])

        def slope(theta: Array) -> Array:
            full = self._effects(model.with_theta(theta), causes)
            white = self.slip.whitened(full, slip_m)[self.rows]
            return np.concatenate([-white, np.diag(1.0 / largest)])

        found = least_squares(
            missed,
            model.theta(),
            slope,
            model.borders(),
            x_scale=largest,
            ftol=FIT_EXACT,
            xtol=FIT_EXACT,
            max_nfev=MOST_FIT_STEPS,
        )
        return model.with_theta(found.x)

    def _explaining(self, missed: Array, effects: Array) -> Array:
        """Return an orthonormal basis of what causes may explain of the misses."""
        labels = [c.cause for c in self.candidates]
        if SIZE in labels:
            # beside the others a size may move nothing but what the wheels have slipped
            others = np.delete(effects, labels.index(SIZE), axis=1)
            basis = _independent(scaled(others)[0])
            moved, left = (
                float(np.linalg.norm(orthogonal(one, basis)))
                for one in (effects[:, labels.index(SIZE)], missed)
            )
            if others.shape[1] and moved * LARGEST_SHOWN[SIZE] < left:
                return basis
        return _independent(scaled(effects)[0])

    def select(self) -> MarksTrial:
        """Return the model with all causes that the marks show."""
        trial = self.trial(Model())
        barred: set[str] = set()
        while len(trial.model.fitted) < MOST_CAUSES:
            wider = self._next(trial, barred)
            if wider is None:
                break
            newest = wider.model.fitted[-1]
            if worth_a_name(newest) and not implausible(newest) and self.shown(wider):
                trial = wider
            barred.add(newest.candidate.cause)
        return trial

    def _next(self, trial: MarksTrial, barred: set[str]) -> MarksTrial | None:
        """Return a trial with the cause that lowers the misses most, if it is not by chance."""
        variance, freedom = self.scatter.variance, self.scatter.freedom
        if freedom < FEWEST_FREEDOM:
            return None
        best, most = None, self.critical()
        for candidate in self.candidates:
            if candidate.cause in barred:
                continue
            model = self.fit(trial.model.plus(candidate, candidate.null))
            missed = self._missed(model)
            statistic = (trial.deviance - float(missed @ missed)) / variance
            if statistic <= most:
                continue
            wider = self.trial(model)
            if self.runs_agree(wider):
                best, most = wider, statistic
        return best

    def critical(self) -> float:
        """Return what a statistic exceeds by chance at the level of the whole library."""
        freedom = max(self.scatter.freedom, 1)
        return float(stats.f.isf(BY_CHANCE / len(self.candidates), 1, freedom))

    def beside(self, trial: MarksTrial, candidate: Candidate) -> Array:
        """Return a cause's effect without what other causes of the model explain of it."""
        column = trial.effects[:, self.candidates.index(candidate)]
        others = [
            self.candidates.index(f.candidate)
            for f in trial.model.fitted
            if f.candidate is not candidate
        ]
        left = orthogonal(column, trial.effects[:, others])
        is_new = left @ left > SMALLEST_SHARE * (column @ column)
        return np.asarray(left if is_new else np.zeros_like(left))

    def _own(self, trial: MarksTrial) -> Array:
        own = [self.candidates.index(f.candidate) for f in trial.model.fitted]
        return np.asarray(trial.effects[:, own])

    def runs_agree(self, trial: MarksTrial) -> bool:
        """Return whether the runs, each by itself, ask for a model's newest cause."""
        newest = trial.model.fitted[-1]
        column = self.beside(trial, newest.candidate)
        asked = (newest.theta[0] - newest.candidate.null[0]) * float(column @ column)

        # what other causes may explain is no disagreement: of the misses, it counts what remains
        left = orthogonal(trial.missed, self._explaining(trial.missed, trial.effects))
        scores = self._by_run(column * left)
        count = len(scores)
        scatter = np.sqrt(float(scores @ scores) * count / (count - 1))
        limit = stats.t.isf(0.5 * BY_CHANCE / len(self.candidates), count - 1)
        return bool(abs(asked) > limit * scatter)

    def _by_run(self, values: Array) -> Array:
        run = np.searchsorted(self.chosen, self.runs.run[self.rows])
        table = values.reshape(len(values), -1)
        sums = np.zeros((len(self.chosen), table.shape[1]))
        np.add.at(sums, run, table)
        return sums if values.ndim > 1 else sums[:, 0]

    def rivals(self, trial: MarksTrial, index: int) -> list[MarksTrial]:
        """Return models with another cause in one's place that the marks cannot exclude."""
        own, found = trial.model.fitted[index], []
        others = trial.model.without(index)
        for candidate in self.candidates:
            if candidate.cause in trial.model.causes or candidate is own.candidate:
                continue
            swapped = self.trial(self.fit(others.plus(candidate, candidate.null)))
            newest = swapped.model.fitted[-1]
            shrunk = abs(_size(swapped.model) - _size(trial.model))
            most = RIVAL * self.scatter.variance + 2.0 * shrunk * trial.deviance
            fits = swapped.deviance - trial.deviance < most
            possible = not implausible(newest) and not _at_bound(newest)
            if fits and possible and self.shown(swapped):
                found.append(swapped)
        return found

    def limits(self, trial: MarksTrial) -> Array:
        """Return 95 % limits of all parameters, shape (k, 2)."""
        own = self._own(trial)
        variance, freedom = self.scatter.variance, self.scatter.freedom
        sums = self._by_run(own * trial.missed[:, None])
        count = max(len(self.chosen), own.shape[1] + 2)
        cov = covariance(own, sums, count, variance)
        return limits(
            trial.model.theta(), cov, max(min(freedom, count - own.shape[1]), 2)
        )

    def smallest(self, trial: MarksTrial, candidate: Candidate) -> float:
        """Return the size of a cause that would be found in five of six such drives."""
        column = self.beside(trial, candidate)
        length = max(float(np.sqrt(column @ column)), 1e-300)
        needed = (np.sqrt(self.critical()) + 1.0) * np.sqrt(self.scatter.variance)
        return max(float(needed) / length, candidate.least)

    def shows(self, trial: MarksTrial, candidate: Candidate) -> bool:
        """Return whether the marks show a cause of a reasonable size beside those of a model."""
        return self.smallest(trial, candidate) <= LARGEST_SHOWN[candidate.cause]

    def shown(self, trial: MarksTrial) -> bool:
        """Return whether the marks show every cause of a model beside all others."""
        return all(self.shows(trial, f.candidate) for f in trial.model.fitted)


def _independent(unit: Array) -> Array:
    """Return an orthonormal basis of what columns of unit length clearly span."""
    left, size, _ = np.linalg.svd(unit, full_matrices=False)
    return np.asarray(left[:, size > 1e-3])


def _size(model: Model) -> float:
    """Return the share by which a model makes the whole robot larger."""
    return sum(f.theta[0] for f in model.fitted if f.candidate.cause == SIZE)


def _at_bound(fitted: Fitted) -> bool:
    value, step = fitted.theta[0], fitted.candidate.step[0]
    low, high = fitted.candidate.low[0] + step, fitted.candidate.high[0] - step
    return not low < value < high
