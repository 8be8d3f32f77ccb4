"""A ranging anchor that is not where it is configured: a smooth bias field of known form.

All ranges to it are too long or too short by about the same amount, so the error of the position
depends on the place. As the form of this field is known, it is tested on its own: among the hundred
columns of unknown structure, its four would hardly count.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.traits import POSITION_FIELD, traits_of
from hilserver.diagnosis.catalogue.vocabulary import cause_of
from hilserver.diagnosis.decide.structure import Unknown, holds_out, joint_gain
from hilserver.diagnosis.decide.trial import cost
from hilserver.diagnosis.decide.unknown import RANGING, anchor_fields
from hilserver.diagnosis.regression.columns import Library
from hilserver.diagnosis.regression.disturbance import Motion
from hilserver.diagnosis.regression.linear import orthogonal
from hilserver.diagnosis.regression.problem import Point, Problem, apart
from hilserver.diagnosis.regression.screen import (
    Blocks,
    adjusted,
    least_t,
    null_maxima,
    score,
)
from hilserver.diagnosis.replay.pose_stage import PoseStage
from hilserver.diagnosis.thresholds import (
    INEXACT,
    INSTEAD_LEAST_GAIN,
    LEAST_USEFUL,
    REST_LEVEL,
    SCREEN_LEVEL,
    SELECTION_LEAST_SAVED,
    TIE,
)
from hilserver.measured.channels import POSITION

ANCHOR_LEVEL: Final = 0.5 * REST_LEVEL
"""A test of its own, in addition to that of all structure, which includes it."""
CORNERS = (
    "low x and low y",
    "high x and low y",
    "high x and high y",
    "low x and high y",
)


@dataclass(frozen=True)
class Anchor:
    """One of four ranging anchors whose ranges are off."""

    side: str  # where it stands relative to the area driven
    # what is added to its ranges, and half the width of its 95 % interval
    error_m: float
    half_m: float
    largest: float  # largest error of the position per metre of range error


def _fields(problem: Problem, point: Point) -> tuple[Array, Array] | None:
    """Return the fields of four anchors, or None where no position is judged in one frame.

    Returns
    -------
    ndarray, shape (4, m, 2)
        See `unknown.anchor_fields`.
    ndarray, shape (n, 4)
        Their columns, whitened, initial poses projected out.
    """
    stage = problem.stage
    if (
        not isinstance(stage, PoseStage)
        or stage.begins_anew
        or stage.log.pose_errors_last  # an effect of the place like any other
        or POSITION[0] not in stage.stack.edges
    ):
        return None
    motion = Motion(stage, problem, point)
    moved = anchor_fields(motion)
    columns = np.stack([motion.placed(*field.T) for field in moved], axis=1)
    return moved, problem.shown(point, columns)


def _anchor(moved: Array, number: int, error_m: float, half_m: float) -> Anchor:
    return Anchor(CORNERS[number], error_m, half_m, float(np.hypot(*moved.T).max()))


def anchor_off(
    library: Library,
    point: Point,
    unknown: Sequence[Unknown],
    rng: np.random.Generator,
    explained: float,
) -> tuple[Anchor, float] | None:
    """Return the anchor that the residual of a model indicates, with its p, or None.

    It must hold on blocks that it was not fitted to, and explain more than any cause of the library
    and any unknown structure that was found; otherwise nothing is concluded.

    Parameters
    ----------
    explained : float
        Deviance saved by the accepted causes, whose inexactness may leave a small share of it.

    Returns
    -------
    Anchor
    float
        Family-wise over the anchors, scaled to compare with the level of the screen.
    """
    problem = library.problem
    fields = _fields(problem, point)
    if fields is None:
        return None
    stack = problem.stack
    moved, white = fields[0], orthogonal(fields[1], problem.accepted(point))
    blocks = Blocks.of(stack.block, stack.n_blocks)
    scores = score(white[blocks.order], point.left[blocks.order], blocks)
    best = int(np.argmax(scores.gain))
    t, gain = abs(float(scores.t[best])), float(scores.gain[best])
    positions = sum(e.stop - e.start for n, e in stack.edges.items() if n in POSITION)
    if t < least_t(ANCHOR_LEVEL) or gain < max(
        INSTEAD_LEAST_GAIN, LEAST_USEFUL * positions, INEXACT * explained
    ):
        return None
    others = [u.gain for u in unknown if u.family.name != RANGING]
    if gain - TIE < max(_rival(library, point), *others, 0.0):
        return None
    p = float(adjusted(np.array([t]), null_maxima([scores], rng))[0])
    if p >= ANCHOR_LEVEL or not holds_out(
        problem, white[:, [best]], point.left, SELECTION_LEAST_SAVED
    ):
        return None
    half_m = 1.96 * float(scores.deviation[best] / scores.information[best])
    found = _anchor(moved[best], best, float(scores.size[best]), half_m)
    return found, p * SCREEN_LEVEL / ANCHOR_LEVEL


@dataclass(frozen=True)
class Contest:
    """An accepted scale of the navigation, compared with misplaced anchors.

    A scale is the simplest error field of one misplaced anchor, and so the first to be found.
    """

    scale: int  # its index among the accepted causes
    # deviance that one anchor, or all four (less one for each), saves beyond the scale: more than
    # `TIE`, there is no scale; within it, the data do not decide
    more: float
    anchor: Anchor  # the one that explains most in place of the scale


def scale_or_anchor(problem: Problem, point: Point) -> Contest | None:
    """Compare an accepted scale of the navigation with misplaced anchors; None without a scale."""
    accepted = problem.accepted(point)
    index = next(
        (i for i, c in enumerate(point.model.causes) if traits_of(c).field), None
    )
    if accepted is None or index is None:
        return None
    fields = _fields(problem, point)
    if fields is None:
        return None
    others, own = apart(point, accepted, index)
    target = orthogonal(point.left + own, others)
    moved, white = fields[0], orthogonal(fields[1], others)
    explained = float(target @ target - point.left @ point.left)
    squares, along = (white**2).sum(axis=0) + 1e-300, white.T @ target
    best = int(np.argmax(along**2 / squares))
    most = max(float(along[best] ** 2 / squares[best]), joint_gain(white, target))
    error_m, half_m = (
        float(along[best] / squares[best]),
        1.96 / float(np.sqrt(squares[best])),
    )
    return Contest(index, most - explained, _anchor(moved[best], best, error_m, half_m))


def _rival(library: Library, point: Point) -> float:
    """Return the most that any cause of the library would save, minus its cost."""
    gain = library.scores(point).gain
    saved = (
        float(gain[library.owner == i].max()) - cost(c, 0.0)
        for i, c in enumerate(library.candidates)
        if c.cause != cause_of(POSITION_FIELD).name
    )
    return max(saved, default=0.0)
