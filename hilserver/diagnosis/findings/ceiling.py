"""How much better a model could be at all: a flexible regression on every direction at once."""

from collections.abc import Mapping

import numpy as np

from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.gain import gains
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.schema.findings import Gain
from hilserver.measured.arrays import Array


def flexible(problem: Problem, library: Library, point: Point) -> Array:
    """Return the held-out prediction of a ridge regression on all columns of the library.

    The coefficients of each half of the blocks come from the other half; the base is the model at
    `point`, the effects are taken as linear there.
    """
    order = library.blocks.order
    fold = problem.stack.fold[problem.stack.block]
    prediction = point.predicted.copy()
    for test in (0, 1):
        train = (fold != test)[order]
        if not train.any() or train.all():
            continue
        weight = library.ridge(point, train)
        rows = np.flatnonzero(fold == test)
        prediction[rows] += library.effect(weight, rows)
    return prediction


def ceilings(
    problem: Problem,
    library: Library,
    point: Point,
    before: Array,
    horizon_s: float,
    rng: np.random.Generator,
) -> Mapping[str, float]:
    """Return the held-out ratio that the flexible regression reaches, by quantity."""
    after = flexible(problem, library, point)
    reached: dict[str, Gain] = gains(problem, before, after, horizon_s, rng)
    return {key: gain.ratio for key, gain in reached.items()}
