"""How much better a model could be at all: a flexible regression on every direction at once."""

from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.findings.worth import Part
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.gain import gains
from hilserver.diagnosis.regression.problem import Point, Problem

DIGITS: Final = 5  # the rest of a ceiling hangs on how many threads share its large products


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


def ceilings(part: Part, horizon_s: float, rng: np.random.Generator) -> dict[str, float]:
    """Return the held-out ratio that the flexible regression reaches, by quantity."""
    library, point = part.judged.prepared.library, part.judged.point
    library.rewhiten(point)
    after = flexible(part.problem, library, point)
    reached = gains(part.problem, part.before, after, horizon_s, rng)
    return {key: float(f"{gain.ratio:.{DIGITS}g}") for key, gain in reached.items()}
