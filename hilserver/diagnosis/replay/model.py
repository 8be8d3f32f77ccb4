"""The model under test: the configured plant with accepted causes at their fitted values."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import accumulate, pairwise

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.catalogue.vocabulary import OF_THE_LOG
from hilserver.plant.parameters import RobotParameters


@dataclass(frozen=True)
class Fitted:
    """One candidate and the values of its parameters, shape (candidate.n,)."""

    candidate: Candidate
    theta: tuple[float, ...]

    @property
    def terms(self) -> Mapping[str, float]:
        """Values by term."""
        return self.candidate.terms(self.theta)


@dataclass(frozen=True)
class Model:
    """Accepted causes."""

    fitted: tuple[Fitted, ...] = field(default=())  # in the order of their acceptance

    @property
    def terms(self) -> dict[str, float]:
        """All terms by name: those of the plant and the corrections of stamps and fields."""
        values: dict[str, float] = {}
        for f in self.fitted:
            values.update(f.terms)
        return values

    @property
    def causes(self) -> tuple[str, ...]:
        """Names of the causes."""
        return tuple(f.candidate.cause for f in self.fitted)

    @property
    def slices(self) -> tuple[slice, ...]:
        """Where each cause's parameters lie in `theta`, and its columns in `Problem.accepted`."""
        ends = accumulate((f.candidate.n for f in self.fitted), initial=0)
        return tuple(slice(begin, end) for begin, end in pairwise(ends))

    @property
    def of_the_machine(self) -> frozenset[int]:
        """Indices of the causes that a patch can hold; the others correct the log."""
        by_place = enumerate(self.fitted)
        return frozenset(
            i for i, f in by_place if f.terms.keys().isdisjoint(OF_THE_LOG)
        )

    def theta(self) -> Array:
        """Return all parameters in one vector."""
        return np.array([v for f in self.fitted for v in f.theta])

    def borders(self) -> tuple[Array, Array]:
        """Return the lower and the upper bound of every parameter."""
        low = np.array([v for f in self.fitted for v in f.candidate.low])
        high = np.array([v for f in self.fitted for v in f.candidate.high])
        return low, high

    def with_theta(self, theta: Array) -> "Model":
        """Return the model with other values of its parameters."""
        return Model(
            tuple(
                Fitted(f.candidate, tuple(float(v) for v in theta[mine]))
                for f, mine in zip(self.fitted, self.slices, strict=True)
            )
        )

    def plus(self, candidate: Candidate, theta: tuple[float, ...]) -> "Model":
        """Return the model with one more cause, which replaces those that share a term with it."""
        new = Fitted(candidate, theta)
        others = (f for f in self.fitted if new.terms.keys().isdisjoint(f.terms))
        return Model((*others, new))

    def without(self, *causes: int) -> "Model":
        """Return the model without some of its causes, given by index."""
        return Model(tuple(f for i, f in enumerate(self.fitted) if i not in causes))

    def swapped(
        self, index: int, candidate: Candidate, theta: tuple[float, ...]
    ) -> "Model":
        """Return the model with one cause replaced."""
        fitted = list(self.fitted)
        fitted[index] = Fitted(candidate, theta)
        return Model(tuple(fitted))


def robot_with(robot: RobotParameters, terms: Mapping[str, float]) -> RobotParameters:
    """Return the plant with the terms of a model added to its own."""
    return replace(robot, terms={**robot.terms, **terms})
