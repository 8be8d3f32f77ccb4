"""The rung below a name: what makes held-out predictions better and asserts no cause.

A cause loses its name where much error remains that it does not explain, or where something else
explains as much. That casts doubt on the word, not on the prediction: "acts like a rotation gain
22 % larger; what is behind it, these data do not tell". Such an item must pass the screen of a
name, predict blocks left out of its fit, and be possible in a machine. The whole log decides last:
each half must find it, with one sign, and predict the other better by it, see `findings.nested`;
and another part of the log would show it with the same sign.
"""

from collections.abc import Sequence
from typing import Final

import numpy as np
from scipy import stats

from hilserver.diagnosis.decide.promise import ModelExchange
from hilserver.diagnosis.decide.trial import at_bound, implausible, wald
from hilserver.diagnosis.regression.fitting import fit_without
from hilserver.diagnosis.regression.linear import orthogonal
from hilserver.diagnosis.regression.problem import Point, Problem, apart
from hilserver.diagnosis.regression.screen import critical, null_maxima
from hilserver.diagnosis.regression.stages import Prepared
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.decisions import Decision
from hilserver.diagnosis.thresholds import (
    EFFECTIVE_BLOCKS,
    FEWEST_BLOCKS,
    ONE_SIZE,
    STRETCHES,
)

ACTS: Final = "predicts better on held-out blocks, and asserts no cause"


def with_effective(
    p: Prepared,
    named: Point,
    whole: Point,
    rng: np.random.Generator,
    rows: list[Decision],
) -> tuple[Point, frozenset[str]]:
    """Return the model of named and effective items, and which of them are effective.

    Parameters
    ----------
    named : Point
        The causes that have a name.
    whole : Point
        All that predicts, with the named causes.
    """
    problem = p.problem
    causes = whole.model.causes
    known = frozenset(named.model.causes)
    nameless = [index for index, cause in enumerate(causes) if cause not in known]

    few = problem.stack.n_blocks < EFFECTIVE_BLOCKS
    if few or not nameless or not known.issubset(causes):
        return named, frozenset()

    limit = critical(null_maxima([p.library.scores(whole)], rng))
    left = [index for index in nameless if not _earns(problem, whole, index, limit)]
    effective = frozenset(causes) - known - {causes[index] for index in left}
    if not effective:
        return named, effective

    rows += [Decision(cause, "taken", None, ACTS) for cause in sorted(effective)]
    point = fit_without(problem, whole, *left) if left else whole
    return point, effective


def _earns(problem: Problem, whole: Point, index: int, limit: float) -> bool:
    """Return whether an item of a model is effective, as far as its own blocks show.

    Parameters
    ----------
    limit : float
        The deviate that an effect must exceed, as for a name.
    """
    f = whole.model.fitted[index]
    if at_bound(f) or implausible(f):
        return False
    if wald(problem, whole, index) <= limit:
        return False
    step = ModelExchange(problem, fit_without(problem, whole, index), whole)
    return step.earns and not step.harms


def recurs(problem: Problem, point: Point, index: int) -> bool:
    """Return whether another part of the log would show an item with the same sign.

    Notes
    -----
    Consecutive parts have one size by Cochran's Q; on a real log a block's own error does not
    follow from its samples, so the scatter of the blocks within the parts is the unit: an F test.
    Or their sizes differ, as on a floor that is not the same everywhere, but the prediction
    interval of one more of them does not hold zero: it gains there all the same.
    """
    columns = problem.accepted(point)
    assert columns is not None
    others, _ = apart(point, columns, index)
    own = orthogonal(problem.effect(point, index), others)
    information = problem.stack.block_sums(own**2)
    scores = problem.stack.block_sums(own * point.left)

    shows = np.flatnonzero(information > 1e-9 * information.sum())
    count = min(STRETCHES, len(shows) // FEWEST_BLOCKS)
    if count < 2:
        return True

    parts = np.array_split(shows, count)
    weights = np.array([information[blocks].sum() for blocks in parts])
    away = np.array([scores[blocks].sum() for blocks in parts]) / weights
    mean = float(np.average(away, weights=weights))
    between = float(weights @ (away - mean) ** 2)

    each = float((scores[shows] ** 2 / information[shows]).sum())
    freedom = len(shows) - count
    within = max(each - float(weights @ away**2), 1e-300) / freedom
    f = between / (count - 1) / within
    if stats.f.sf(f, count - 1, freedom) > ONE_SIZE:
        return True

    sizes = 1.0 + away  # times the fitted one
    width = sizes.std(ddof=1) * np.sqrt(1.0 + 1.0 / count)
    return bool(sizes.mean() > stats.t.isf(0.5 * ONE_SIZE, count - 1) * width)


def same_sign(fitted: Sequence[Fitted]) -> bool:
    """Return whether all fits of an item point the same way from no effect."""
    away = [np.subtract(f.theta, f.candidate.null) for f in fitted]
    along = np.array(away) @ away[0]
    return bool((along > 0.0).all())
