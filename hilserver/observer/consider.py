"""How well a model's parameters are known: directions in which they vary together."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Final

import numpy as np
from numpy.typing import NDArray

from hilserver.observer.layout import (
    MOST_DIRECTIONS,
    N_FIGURES,
    N_PARAMETERS,
    FilterFigures,
)
from hilserver.plant.errors import PlantError
from hilserver.plant.layout import Parameters
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.terms import TERMS

BLOCKS: Final = ("kinematics", "navigation", "inertial")
ENCODERS: Final = ("encoder_scale.a", "encoder_scale.wheel")
"""Terms that the observer takes into account: those of these blocks, and of the encoders."""
# share of the largest variance below which a direction is left out
LEAST_SHARE: Final = 1e-6


def _is_seen(name: str) -> bool:
    return name in TERMS and (TERMS[name].block in BLOCKS or name in ENCODERS)


def directions(
    robot: RobotParameters, names: Sequence[str], covariance: NDArray[np.float64]
) -> list[Parameters]:
    """Return the parameters of a robot at one standard deviation of each direction.

    Parameters
    ----------
    robot : RobotParameters
        With the terms of the model.
    names : sequence of str
        What was fitted together; all but the terms that the observer uses are left out.
    covariance : ndarray, shape (n, n)
        Their covariance, in their units.
    """
    seen = [i for i, n in enumerate(names) if _is_seen(n)]
    if not seen:
        return []
    part = covariance[np.ix_(seen, seen)]
    sd = np.sqrt(np.diag(part))
    seen_sd = np.where(sd > 0.0, sd, 1.0)
    sizes, axes = np.linalg.eigh(part / np.outer(seen_sd, seen_sd))
    kept = np.flatnonzero(sizes > LEAST_SHARE * sizes[-1])[-MOST_DIRECTIONS:]
    found = []
    for k in kept:
        move = np.sqrt(sizes[k]) * axes[:, k] * sd
        found.append(
            _moved(robot, dict(zip((names[i] for i in seen), move, strict=True)))
        )
    return found


def alternatives(
    robot: RobotParameters, groups: Sequence[Mapping[str, float]]
) -> list[Parameters]:
    """Return directions towards models that a diagnosis cannot distinguish from the present one.

    The other cause of a group is as likely as the one in the model, so the mean square of the error
    is half the square of the change to the other: a direction of 1/sqrt(2) of this change.

    Parameters
    ----------
    groups : sequence of mapping
        Terms of all causes of a group by name, with the value that each would have.
    """
    found, base = [], pack(robot)
    for group in groups:
        terms = {name: value for name, value in group.items() if _is_seen(name)}
        taken = {
            TERMS[name].cause
            for name in terms
            if robot.terms.get(name) not in {None, 0.0}
        }
        if not taken:
            continue
        kept = {n: v for n, v in robot.terms.items() if n not in terms}
        for cause in dict.fromkeys(TERMS[name].cause for name in terms):
            own = {
                name: value
                for name, value in terms.items()
                if TERMS[name].cause == cause
            }
            if cause in taken:
                continue
            try:
                other = pack(replace(robot, terms=kept | own))
            except PlantError:
                continue  # the other cause has no meaning for this robot
            same = other.numbers == base.numbers
            by = np.where(same, 0.0, other.numbers) - np.where(same, 0.0, base.numbers)
            found.append(Parameters.of(base.numbers + by / np.sqrt(2.0)))
    return found


def _moved(robot: RobotParameters, by: Mapping[str, float]) -> Parameters:
    """Return the parameters with terms moved, within their ranges; the other way if invalid."""
    last: PlantError | None = None
    for sign in (1.0, -1.0):
        terms = dict(robot.terms)
        for name, step in by.items():
            term = TERMS[name]
            at = terms.get(name)
            value = (term.null if at is None else at) or 0.0
            terms[name] = min(max(value + sign * float(step), term.low), term.high)
        try:
            return pack(replace(robot, terms=terms))
        except PlantError as error:
            last = error
    raise PlantError(f"the parameter uncertainty does not match the robot: {last}")


def constants(
    figures: FilterFigures, moved: Sequence[Parameters]
) -> NDArray[np.float64]:
    """Return the array `c` of the filter's kernels."""
    c = np.zeros(N_FIGURES + len(moved) * N_PARAMETERS)
    c[:N_FIGURES] = figures.numbers
    known = FilterFigures.of(c)
    known.directions = len(moved)
    known.considered = len(moved) + (known.instant_sd > 0.0)
    for j, other in enumerate(moved):
        first = N_FIGURES + j * N_PARAMETERS
        c[first : first + N_PARAMETERS] = other.numbers
    return c
