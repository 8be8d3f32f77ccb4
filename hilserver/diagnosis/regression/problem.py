"""One stage as a regression: whitened residuals, free initial poses projected out.

Everything that judges a cause works on this: the deviance (sum of squares of the whitened
residuals, in expectation one per sample), each block's share of it, and columns of sensitivities
that went through the same whitening and projection.
"""

from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final, TypeVar, cast

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.noise.fitting import fit_noise, robust_weights, short_noise
from hilserver.diagnosis.noise.quick_noise import (
    isolated,
    noise_of_neighbours,
    plain_noise,
    spikes,
)
from hilserver.diagnosis.noise.readings import Reading, noise_of_readings
from hilserver.diagnosis.noise.whitening import Filter, NoiseModel
from hilserver.diagnosis.regression.free_poses import Bases, FreePoses
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.replay.stack import Stack
from hilserver.diagnosis.replay.stage import Stage
from hilserver.diagnosis.thresholds import GROSS, NEGLIGIBLE, NOISE_TAU_MAX_S
from hilserver.measured.channels import POSITION

T = TypeVar("T")
_Kept = deque[tuple[tuple[object, ...], Any]]
POINTS_KEPT: Final = 4  # whose bases are kept: each is as large as three predictions
PREDICTIONS_KEPT: Final = 14  # a step at a bound, or one tried again, needs them again


@dataclass(frozen=True)
class Point:
    """A model with its poses and its residuals."""

    model: Model
    poses: Array  # shape (segments, 3)
    predicted: Array  # shape (n,)
    white: Array  # shape (n,): whitened residual
    left: Array  # shape (n,): the same, initial poses projected out
    loss: Array  # shape (blocks,): sum of the squares of `left` over each block
    noise: Mapping[str, NoiseModel] | None = None  # under which it was evaluated

    @property
    def deviance(self) -> float:
        """Sum over all blocks."""
        return float(self.loss.sum())

    @property
    def is_gross(self) -> bool:
        """Whether it leaves far more than noise."""
        return self.deviance > GROSS * len(self.left)


@dataclass
class Problem:
    """A stage with its noise model."""

    stage: Stage
    # by channel; replaced, never modified, when estimated again
    noise: Mapping[str, NoiseModel] = field(default_factory=dict)
    # shape (n,): 1, or 0 for outliers; also replaced
    weights: Array = field(default_factory=lambda: np.zeros(0))
    # the drive hunts in a way that no replay can follow: the residual counts as noise
    ripples: bool = False

    def __post_init__(self) -> None:
        if not len(self.weights):
            self.weights = np.ones(len(self.stage.stack))
        self._runs = list(self.stage.stack.runs())
        self._filter = (self.noise, np.zeros(0), Filter.empty(0))
        self._known, self._white, self._left = (_Kept(maxlen=2) for _ in range(3))
        self._bases = _Kept(maxlen=POINTS_KEPT)
        self._shown = _Kept(maxlen=PREDICTIONS_KEPT)
        self._poses = FreePoses.of(self.stage.stack.segment, len(self.stage.segments))
        limits = self.stage.log.limits
        self.readings = {
            name: Reading.of(self.stack.values[edge], limits.get(name, np.inf))
            for name, edge in self.stack.edges.items()
        }

    @property
    def stack(self) -> Stack:
        """The stage's samples."""
        return self.stage.stack

    @property
    def is_short(self) -> bool:
        """Whether slow noise would look like a misfit, so that no noise is learned from a model."""
        return self.stage.segments.longest_s < NOISE_TAU_MAX_S

    def under(self, noise: Mapping[str, NoiseModel], weights: Array) -> "Problem":
        """Return the same stage with another noise."""
        return replace(self, noise=noise, weights=weights)

    # --- predictions ------------------------------------------------------------------------------
    def predict(
        self, terms: Mapping[str, float], poses: Array, *, keep: bool = False
    ) -> Array:
        """Return what the sensors show, on average, with the terms of a model."""
        key = (*terms.items(), poses.tobytes())
        lately = (shown for known, shown in list(self._shown) if known == key)
        if (shown := next(lately, None)) is None:
            shown = self.stage.predict(terms, poses, keep=keep)
            self._shown.append((key, shown))
        exact = shown.copy()
        for name, reading in self.readings.items():
            if np.isfinite(reading.limit):
                edge = self.stack.edges[name]
                exact[edge] = reading.mean(exact[edge], self.noise.get(name))
        return exact

    def forget(self) -> None:
        """Drop what is kept for the next steps of a search, as there are none."""
        for kept in (self._shown, self._bases, self._known, self._white, self._left):
            kept.clear()

    def residual(self, predicted: Array) -> Array:
        """Return measured minus predicted."""
        return self.stage.difference(self.stack.values, predicted)

    def start_poses(self, terms: Mapping[str, float]) -> Array:
        """Return first guesses of the initial poses, if there are any."""
        return self.stage.start_poses(terms)

    def nuisance(self, predicted: Array, poses: Array) -> Array | None:
        """Return the raw columns of the initial poses, or None."""
        return self.stage.nuisance(predicted, poses)

    # --- whitening and projection -----------------------------------------------------------------
    def whiten(self, columns: Array) -> Array:
        """Whiten raw columns, shape (n,) or (n, k), channel by channel and segment by segment."""
        noise, weights, known = self._filter
        if noise is not self.noise or weights is not self.weights:
            noise, weights, known = (
                self.noise,
                self.weights,
                Filter.empty(len(self.stack)),
            )
            for name, _, part in self._runs:
                known.prepare(part, noise[name], self.stack.t_s, weights)
            self._filter = noise, weights, known
        return known.whiten(columns)

    def bases(self, nuisance: Array | None) -> Bases | None:
        """Return bases of what the initial poses of the segments explain."""
        return None if nuisance is None else self._poses.bases(self.whiten(nuisance))

    def bases_at(self, point: Point) -> Bases | None:
        """Return the bases at a point, under the current noise; cached for the last points."""
        return _once(
            self._bases,
            (point, self.noise, self.weights),
            lambda: self.bases(self.nuisance(point.predicted, point.poses)),
        )

    def project(self, white: Array, bases: Bases | None) -> Array:
        """Project the free initial poses out of whitened columns."""
        return white if bases is None else bases.project(white)

    # --- points -----------------------------------------------------------------------------------
    def point(self, model: Model, poses: Array, *, pose_steps: int = 1) -> Point:
        """Evaluate a model, with its initial poses refitted."""
        terms = model.terms
        predicted = self.predict(terms, poses, keep=True)
        bases = self.bases(self.nuisance(predicted, poses))
        white = self.whiten(self.residual(predicted))
        for _ in range(pose_steps if bases is not None else 0):
            assert bases is not None
            poses = poses + bases.step(white)
            predicted = self.predict(terms, poses, keep=True)
            bases = self.bases(self.nuisance(predicted, poses))
            white = self.whiten(self.residual(predicted))
        left = self.project(white, bases)
        loss = self.stack.block_sums(left * left)
        point = Point(model, poses, predicted, white, left, loss, self.noise)
        self._bases.append(((point, self.noise, self.weights), bases))
        return point

    def columns(
        self, point: Point, model: Model, which: Sequence[int] | None = None
    ) -> Array:
        """Return the raw sensitivities of a model's parameters, all or some, shape (n, k)."""
        theta, step = (
            model.theta(),
            np.array([s for f in model.fitted for s in f.candidate.step]),
        )
        low, high = model.borders()
        # beyond its bound a parameter may be one that the plant does not accept
        step = np.where((theta + step < low) | (theta + step > high), -step, step)
        which = range(len(theta)) if which is None else which
        base = point.predicted
        out = np.empty((len(self.stack), len(which)))
        for column, j in enumerate(which):
            moved = theta.copy()
            moved[j] += step[j]
            terms = model.with_theta(moved).terms
            shown = self.predict(terms, point.poses)
            out[:, column] = self.stage.difference(shown, base) / step[j]
        return out

    def own_columns(self, point: Point) -> Array:
        """Return the raw sensitivities of a point's own parameters; cached for the last points."""
        return _once(self._known, (point,), lambda: self.columns(point, point.model))

    def own_white(self, point: Point) -> Array:
        """Return the same, whitened; cached for the last points."""
        key = (point, self.noise, self.weights)
        return _once(self._white, key, lambda: self.whiten(self.own_columns(point)))

    def shown(self, point: Point, columns: Array) -> Array:
        """Return the effect of raw columns at a point: whitened, initial poses projected out."""
        return self.project(self.whiten(columns), self.bases_at(point))

    def accepted(self, point: Point) -> Array | None:
        """Return whitened, projected sensitivities of a model's own parameters; also cached."""
        if not point.model.fitted:
            return None
        key = (point, self.noise, self.weights)
        bases = self.bases_at(point)
        return _once(
            self._left, key, lambda: self.project(self.own_white(point), bases)
        )

    def effect(self, point: Point, index: int) -> Array:
        """Return the effect of a point's cause, whitened and projected, shape (n,)."""
        without = self.predict(point.model.without(index).terms, point.poses)
        return self.shown(point, self.stage.difference(point.predicted, without))

    def column(self, point: Point, candidate: Candidate) -> Array:
        """Return the raw effect of a candidate per unit, or at its start value; shape (n, k)."""
        if not candidate.linear:
            model = point.model.plus(candidate, candidate.start)
            predicted = self.predict(model.terms, point.poses)
            return self.stage.difference(predicted, point.predicted)[:, None]
        out = np.empty((len(self.stack), candidate.n))
        for j in range(candidate.n):
            theta = list(candidate.null)
            theta[j] += candidate.step[j]
            moved = point.model.plus(candidate, tuple(theta))
            predicted = self.predict(moved.terms, point.poses)
            moved_by = self.stage.difference(predicted, point.predicted)
            out[:, j] = moved_by / candidate.step[j]
        return out

    # --- noise ------------------------------------------------------------------------------------
    def estimate_noise(self, raw: Array) -> None:
        """Fit the noise of every channel to raw residuals; outliers lose their weight."""
        if self.is_short:
            self._estimate_short_noise(raw)
            return
        self.noise = {name: self._noise_of(name, raw) for name in self.stack.channels}
        weights = np.ones(len(self.stack))
        for name, _, part in self._runs:
            if name in POSITION:
                weights[part] = ~spikes(self.stack.t_s[part], raw[part])
        self.weights = weights
        for _ in range(2):
            white, weights = self.whiten(raw), self.weights.copy()
            for name in POSITION:
                if name in self.stack.edges:
                    edge = self.stack.edges[name]
                    weights[edge] *= ~isolated(white[edge])
            self.weights = weights

    def _noise_of(self, name: str, raw: Array) -> NoiseModel:
        """Return the noise of a channel; readings at a limit do not show any."""
        stack, reading, parts = self.stack, self.readings[name], []
        exact = stack.values - raw
        for part in (part for n, _, part in self._runs if n == name):
            free = np.abs(exact[part]) < (1.0 - NEGLIGIBLE) * reading.limit
            columns = (stack.t_s[part], raw[part], exact[part], stack.values[part])
            parts.append(tuple(column[free] for column in columns))
        residuals = [(t, r) for t, r, _, _ in parts]
        readings = [(t, x, y) for t, _, x, y in parts]
        if self.stage.memoryless and not self.ripples:
            rounded = (
                noise_of_readings(readings, reading) if reading.step > 0.0 else None
            )
            return rounded or noise_of_neighbours(residuals)
        found, rounding = (
            plain_noise(residuals) or fit_noise(residuals),
            reading.step / 12.0**0.5,
        )
        if found.sd >= rounding:
            return found
        # at standstill there is one value; no reading is more exact than its rounding
        return noise_of_readings(readings, reading) or NoiseModel(rounding)

    def _estimate_short_noise(self, raw: Array) -> None:
        noise, weights = {}, np.ones(len(self.stack))
        for name in self.stack.channels:
            mine = [part for n, _, part in self._runs if n == name]
            noise[name], scale = short_noise([raw[part] for part in mine])
            for part in mine if scale else ():
                weights[part] = robust_weights(raw[part] / scale)
        self.noise, self.weights = noise, weights


def _once(kept: _Kept, key: tuple[object, ...], compute: Callable[[], T]) -> T:
    """Return what was recently computed from the same objects, or compute it; read-only."""
    for known, found in list(kept):
        if all(a is b for a, b in zip(known, key, strict=True)):
            return cast("T", found)
    found = compute()
    kept.append((key, found))
    return found


def apart(point: Point, accepted: Array, index: int) -> tuple[Array, Array]:
    """Return the columns of the other accepted causes, and the effect of one of them."""
    f, mine = point.model.fitted[index], point.model.slices[index]
    own = accepted[:, mine] @ (np.asarray(f.theta) - np.asarray(f.candidate.null))
    return np.delete(accepted, mine, axis=1), own
