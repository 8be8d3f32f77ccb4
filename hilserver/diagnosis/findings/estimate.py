"""The fitted parameters of a model together: names and units as reported, one covariance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG
from hilserver.diagnosis.regression.intervals import whole_covariance
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.schema.findings import Joint
from hilserver.diagnosis.thresholds import PARTNER_CORRELATION


def is_wave(f: Fitted) -> bool:
    """Return whether a cause is reported as amplitude and phase, fitted as cosine and sine."""
    return any(name.endswith(("phase", "phase1", "phase2")) for name in f.terms)


@dataclass(frozen=True)
class StageEstimate:
    """All fitted parameters of one stage, as reported."""

    names: tuple[str, ...]
    owner: tuple[int, ...]  # cause of each, as its index in the model
    value: Array  # shape (k,)
    # shape (k, k): robust; in directions that the data leave open, that of the priors
    covariance: Array

    @classmethod
    def none(cls) -> "StageEstimate":
        """Return the estimate of a model without any cause."""
        return cls((), (), np.zeros(0), np.zeros((0, 0)))

    @classmethod
    def of(cls, model: Model, covariance: Array) -> "StageEstimate":
        """Return fitted parameters as they are reported.

        Parameters
        ----------
        covariance : ndarray, shape (k, k)
            Of the parameters as fitted.
        """
        names: list[str] = []
        owner: list[int] = []
        values: list[float] = []
        for i, f in enumerate(model.fitted):
            shown = dict(list(f.terms.items())[: f.candidate.n])
            names += [OF_THE_LOG.get(name, name) for name in shown]
            values += shown.values()
            owner += [i] * f.candidate.n
        turn, known = reported(model), with_priors(covariance, priors(model))
        return cls(tuple(names), tuple(owner), np.array(values), turn @ known @ turn.T)

    def partners(self, index: int) -> frozenset[int]:
        """Return the causes that could take over part of what a cause explains."""
        sd = np.sqrt(np.maximum(np.diag(self.covariance), 1e-300))
        alike = np.abs(self.covariance / np.outer(sd, sd)) > PARTNER_CORRELATION
        owner = np.array(self.owner)
        near = owner[alike[owner == index].any(axis=0)]
        return frozenset(near.tolist()) - {index}


def estimate_of(problem: Problem, point: Point) -> StageEstimate:
    """Return the estimate of a fitted model."""
    if not point.model.fitted:
        return StageEstimate.none()
    return StageEstimate.of(point.model, whole_covariance(problem, point)[0])


def joint(estimates: Sequence[StageEstimate]) -> Joint | None:
    """Return the parameters of all stages together; None without any."""
    fitted = [e for e in estimates if e.names]
    if not fitted:
        return None
    whole = block_diag(*(e.covariance for e in fitted))
    return Joint(
        parameters=tuple(name for e in fitted for name in e.names),
        value=tuple(float(v) for e in fitted for v in e.value),
        covariance=tuple(tuple(row) for row in whole.tolist()),
    )


def reported(model: Model) -> Array:
    """Return the derivatives of the reported parameters by the fitted ones, shape (k, k)."""
    return np.asarray(
        block_diag(
            *(
                _polar(f.theta) if is_wave(f) else np.eye(f.candidate.n)
                for f in model.fitted
            )
        )
    )


def _polar(theta: Sequence[float]) -> Array:
    """Return the derivatives of amplitude and phase by the cosine and the sine part."""
    a, b = theta
    size = max(float(np.hypot(a, b)), 1e-9)
    return np.array([[a / size, b / size], [-b / size**2, a / size**2]])


def priors(model: Model) -> Array:
    """Return the prior standard deviation of every parameter, shape (k,)."""
    return np.array([f.candidate.prior for f in model.fitted for _ in f.theta])


def with_priors(covariance: Array, prior: Array) -> Array:
    """Return a covariance combined with what is known beforehand of sound machines."""
    known = np.flatnonzero(np.isfinite(prior))
    if not len(known):
        return covariance
    seen = covariance[np.ix_(known, known)] + np.diag(prior[known] ** 2)
    cross = covariance[:, known]
    return np.asarray(covariance - cross @ np.linalg.solve(seen, cross.T))
