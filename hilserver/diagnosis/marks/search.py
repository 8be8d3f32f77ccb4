"""Which causes marks show: a search on few numbers, whose independent units are whole runs.

A cause is accepted if it lowers the squared misses by more than chance (F test) and the runs agree
on it (t test of their scores), each at 0.1 % over the whole library. The first test trusts the
marks' standard deviations as far as the best fit of all causes allows, the second trusts nothing.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from scipy import stats

from hilserver.arrays import Array, Indices, Mask
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.decide.trial import implausible, worth_a_name
from hilserver.diagnosis.marks.runs import MarkedRuns, rows_of
from hilserver.diagnosis.marks.slip import RandomSlip
from hilserver.diagnosis.regression.intervals import limits
from hilserver.diagnosis.regression.linear import (
    covariance,
    orthogonal,
    ridge,
    scaled,
)
from hilserver.diagnosis.replay.model import Fitted, Model

BY_CHANCE: Final = 0.001
FEWEST_MARKED_RUNS: Final = 6
FEWEST_FREEDOM: Final = 4  # beyond the causes themselves
MOST_CAUSES: Final = 4
MOST_FIT_STEPS: Final = 12
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
    slip_m : float
        Variance of a wheel's distance per metre, see `RandomSlip`.
    """

    model: Model
    missed: Array
    effects: Array
    slip_m: float

    @property
    def deviance(self) -> float:
        """Sum of the squared misses."""
        return float(self.missed @ self.missed)


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

    def trial(self, model: Model, slip_m: float | None = None) -> MarksTrial:
        """Evaluate a model; random slip is estimated if it is not given."""
        missed = self.runs.residual(model.terms)
        effects = []
        for number, candidate in enumerate(self.candidates):
            self.report(
                f"marks: effect of {candidate.label}", number / len(self.candidates)
            )
            already = {f.candidate.cause: f.theta for f in model.fitted}
            theta = already.get(candidate.cause, candidate.null)
            moved = model.plus(candidate, (theta[0] + candidate.step[0],))
            change = missed - self.runs.residual(moved.terms)
            effects.append(change / candidate.step[0])
        columns = np.stack(effects, axis=1)
        if slip_m is None:
            mine = self.rows
            shown = self._explaining(missed * mine, columns * mine[:, None])
            slip_m = self.slip.estimate(missed, shown, self.chosen)
        missed, columns = (
            self.slip.whitened(one, slip_m)[self.rows] for one in (missed, columns)
        )
        return MarksTrial(model, missed, columns, slip_m)

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

    def level(self, trial: MarksTrial) -> tuple[float, int]:
        """Return the variance that no cause explains, at least 1, and its degrees of freedom."""
        explaining = self._explaining(trial.missed, trial.effects)
        left = orthogonal(trial.missed, explaining)
        freedom = int(self.runs.freedom[self.chosen].sum()) - explaining.shape[1]
        return max(1.0, float(left @ left) / max(freedom, 1)), freedom

    def select(self) -> MarksTrial:
        """Return the model with all causes that the marks show."""
        trial = self.trial(Model())
        barred: set[str] = set()
        while len(trial.model.fitted) < MOST_CAUSES:
            found = self._next(trial, barred)
            if found is None:
                break
            wider = self.fit(trial.model.plus(found, found.null))
            newest = wider.model.fitted[-1]
            if worth_a_name(newest) and not implausible(newest) and self.shown(wider):
                trial = wider
            barred.add(found.cause)
        return trial

    def _next(self, trial: MarksTrial, barred: set[str]) -> Candidate | None:
        variance, freedom = self.level(trial)
        if freedom < FEWEST_FREEDOM:
            return None
        best, most = None, self.critical(freedom)
        for candidate in self.candidates:
            if candidate.cause in barred:
                continue
            statistic = self.statistic(trial, candidate, variance)
            if statistic > most and self.runs_agree(trial, candidate):
                best, most = candidate, statistic
        return best

    def critical(self, freedom: int) -> float:
        """Return what a statistic exceeds by chance at the level of the whole library."""
        return float(stats.f.isf(BY_CHANCE / len(self.candidates), 1, freedom))

    def statistic(
        self, trial: MarksTrial, candidate: Candidate, variance: float
    ) -> float:
        """Return by how many variances a further cause lowers the squared misses."""
        column = self.beside(trial, candidate)
        length = float(column @ column)
        return float(column @ trial.missed) ** 2 / max(length, 1e-300) / variance

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

    def runs_agree(self, trial: MarksTrial, candidate: Candidate) -> bool:
        """Return whether the runs, each by itself, ask for a cause with the same sign."""
        # what other causes may explain is no disagreement: of the misses, it counts what remains
        column = self.beside(trial, candidate)
        own = (
            column * float(column @ trial.missed) / max(float(column @ column), 1e-300)
        )
        left = orthogonal(trial.missed, self._explaining(trial.missed, trial.effects))
        scores = self._by_run(column * (own + left))
        scatter = float(scores.std(ddof=1)) / np.sqrt(len(scores))
        limit = stats.t.isf(0.5 * BY_CHANCE / len(self.candidates), len(scores) - 1)
        return bool(abs(float(scores.mean())) > limit * scatter)

    def _by_run(self, values: Array) -> Array:
        run = np.searchsorted(self.chosen, self.runs.run[self.rows])
        table = values.reshape(len(values), -1)
        sums = np.zeros((len(self.chosen), table.shape[1]))
        np.add.at(sums, run, table)
        return sums if values.ndim > 1 else sums[:, 0]

    def fit(self, model: Model, slip_m: float | None = None) -> MarksTrial:
        """Return a model with the parameters that meet the marks best."""
        trial = self.trial(model, slip_m)
        for _ in range(MOST_FIT_STEPS):
            step = ridge(self._own(trial), trial.missed)
            low, high = model.borders()
            better = None
            for share in (1.0, 0.5, 0.2):
                theta = np.clip(trial.model.theta() + share * step, low, high)
                other = trial.model.with_theta(theta)
                missed = self.runs.residual(other.terms)
                missed = self.slip.whitened(missed, trial.slip_m)[self.rows]
                if float(missed @ missed) < trial.deviance:
                    better = other
                    break
            if better is None:
                break
            before, trial = trial.deviance, self.trial(better, trial.slip_m)
            if before - trial.deviance < 1e-6 * before:
                break
        return trial if slip_m is not None else self.trial(trial.model)

    def rivals(self, trial: MarksTrial, index: int) -> list[MarksTrial]:
        """Return models with another cause in one's place that the marks cannot exclude."""
        variance, _ = self.level(trial)
        own, found = trial.model.fitted[index], []
        others = trial.model.without(index)
        for candidate in self.candidates:
            if candidate.cause in trial.model.causes or candidate is own.candidate:
                continue
            swapped = self.fit(others.plus(candidate, candidate.null), trial.slip_m)
            newest = swapped.model.fitted[-1]
            shrunk = abs(_size(swapped.model) - _size(trial.model))
            most = RIVAL * variance + 2.0 * shrunk * trial.deviance
            fits = swapped.deviance - trial.deviance < most
            possible = not implausible(newest) and not _at_bound(newest)
            if fits and possible and self.shown(swapped):
                found.append(swapped)
        return found

    def limits(self, trial: MarksTrial) -> Array:
        """Return 95 % limits of all parameters, shape (k, 2)."""
        own = self._own(trial)
        variance, freedom = self.level(trial)
        sums = self._by_run(own * trial.missed[:, None])
        count = max(len(self.chosen), own.shape[1] + 2)
        cov = covariance(own, sums, count, variance)
        return limits(
            trial.model.theta(), cov, max(min(freedom, count - own.shape[1]), 2)
        )

    def smallest(self, trial: MarksTrial, candidate: Candidate) -> float:
        """Return the size of a cause that would be found in five of six such drives."""
        variance, freedom = self.level(trial)
        column = self.beside(trial, candidate)
        length = max(float(np.sqrt(column @ column)), 1e-300)
        needed = np.sqrt(self.critical(max(freedom, 1))) + 1.0
        return max(float(needed * np.sqrt(variance)) / length, candidate.least)

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
    value = fitted.theta[0]
    return value in (fitted.candidate.low[0], fitted.candidate.high[0])
