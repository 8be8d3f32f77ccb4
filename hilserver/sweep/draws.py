"""The machine with an index: a function of the sweep's file and the index alone.

Every number of every machine has its own stream (seed, index, name), so neither the number of
workers nor another parameter in the file changes it. Uniform numbers go through the inverse of the
distribution, so normal draws do not depend on a library's method, which may change.
"""

import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from scipy.special import ndtri

from hilserver.arrays import Array
from hilserver.faults import Fault
from hilserver.sweep.model import Distribution, FaultShare

SEEDS: Final = 2**53  # one more than the largest seed of a plant
# moves a uniform number off zero, where the normal distribution has no value
_HALF = 2.0**-54


@dataclass(frozen=True)
class JointDraw:
    """Parameters of one machine that are known jointly."""

    names: tuple[str, ...]  # as in the table of parameters
    value: Array  # shape (k,)
    root: Array  # shape (k, k); times its transpose it is the covariance


@dataclass(frozen=True)
class Draws:
    """All draws of a sweep."""

    seed: int
    population: Mapping[str, Distribution]
    nominal: Mapping[str, float]  # configured value for each name of `population`
    joint: JointDraw | None
    faults: Sequence[FaultShare]

    @property
    def names(self) -> tuple[str, ...]:
        """Parameters that differ from machine to machine."""
        joint = () if self.joint is None else self.joint.names
        return (*(joint), *self.population)

    def plant_seed(self, index: int) -> int:
        """Return the seed of the machine's noise."""
        return int(self._uniform(index, "seed") * SEEDS)

    def values(self, index: int) -> dict[str, float]:
        """Return the machine's parameters, whether or not a robot can have them."""
        found: dict[str, float] = {}
        if self.joint is not None:
            z = [self._normal(index, f"joint:{n}") for n in self.joint.names]
            # Summed in a fixed order: BLAS results differ between processors, machines must not.
            for row, name in enumerate(self.joint.names):
                terms = (float(self.joint.root[row, k]) * z[k] for k in range(len(z)))
                found[name] = float(self.joint.value[row]) + sum(terms)
        for name, distribution in self.population.items():
            found[name] = self._drawn(distribution, name, index)
        return found

    def faults_of(self, index: int) -> list[tuple[int, Fault]]:
        """Return the machine's faults with their numbers, each with a seed of its own."""
        found = []
        for number, item in enumerate(self.faults):
            if self._uniform(index, f"fault:{number}") < item.share:
                seed = item.fault.seed
                if seed is None:
                    seed = int(self._uniform(index, f"fault seed:{number}") * 2**31)
                found.append((number, item.fault.changed(seed=seed)))
        return found

    def _drawn(self, distribution: Distribution, name: str, index: int) -> float:
        u = self._uniform(index, name)
        if distribution.uniform is not None:
            low, high = distribution.uniform
            return low + u * (high - low)
        if distribution.values is not None:
            return distribution.values[int(u * len(distribution.values))]
        mean = self.nominal[name] if distribution.mean is None else distribution.mean
        return mean + (distribution.sd or 0.0) * self._normal(index, name)

    def _normal(self, index: int, name: str) -> float:
        """Return a standard normal number for a machine and a name."""
        return float(ndtri(self._uniform(index, name) + _HALF))

    def _uniform(self, index: int, name: str) -> float:
        """Return a number in 0 .. 1 for a machine and a name."""
        words = np.random.SeedSequence([self.seed, index, zlib.crc32(name.encode())])
        low, high = words.generate_state(2).tolist()
        # The upper 53 of 64 bits, as many as a float64 holds: no number is rounded up to 1.
        return float((high << 21 | low >> 11) * 2.0**-53)


def root_of(covariance: Array) -> Array:
    """Return a matrix that, times its transpose, is the covariance.

    ValueError if it is not a covariance: not symmetric, or with a negative variance.
    """
    if not np.allclose(covariance, covariance.T, rtol=1e-6, atol=1e-15):
        raise ValueError("is not symmetric")
    scale = np.sqrt(np.maximum(np.diag(covariance), 1e-300))
    values, vectors = np.linalg.eigh(covariance / np.outer(scale, scale))
    if values.min(initial=0.0) < -1e-6:
        raise ValueError("is not positive semidefinite")
    size = np.sqrt(np.maximum(values, 0.0))
    root: Array = scale[:, None] * vectors * size
    return root
