"""A ranging anchor that stands elsewhere than configured: a smooth bias field of known form.

All ranges to it are too long or too short by about the same, and the position moves with the place.
Of all smooth fields this is the one that ranging makes, so it is tested for itself: among the
hundred columns of unknown structure four would hardly be heard.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hilserver.diagnosis import screen
from hilserver.diagnosis.columns import Library
from hilserver.diagnosis.disturbance import Motion
from hilserver.diagnosis.pose_stage import POSITION, PoseStage
from hilserver.diagnosis.problem import Point
from hilserver.diagnosis.screen import Blocks, adjusted, null_maxima, orthogonal, score
from hilserver.diagnosis.structure import INEXACT, LEAST_SHARE, Unknown, holds_out
from hilserver.diagnosis.trial import LEAST_SAVED, TIE, cost
from hilserver.diagnosis.unknown import RANGING, anchor_fields

Array = NDArray[np.float64]

LEVEL = 0.0005
"""Family-wise over the anchors, beside the levels of the screen and of unknown structure."""
LEAST_T = 3.4
"""Below it no p is as small as `LEVEL`."""
LEAST_GAIN = 20.0
"""Deviance that an anchor must save."""
SIDES = ("low x and low y", "high x and low y", "high x and high y", "low x and high y")


@dataclass(frozen=True)
class Anchor:
    """One of four ranging anchors measures too long a way.

    Attributes
    ----------
    p : float
        Family-wise over the anchors, weighted so that it compares with the level of the screen.
    side : str
        Where it stands about the driven place, in words.
    error_m, half_m : float
        What is added to its ranges, and half the width of its 95 % interval.
    largest : float
        How far the position moves where it moves most, per metre of the range.
    """

    p: float
    side: str
    error_m: float
    half_m: float
    largest: float


def anchor_off(
    library: Library,
    point: Point,
    unknown: Sequence[Unknown],
    rng: np.random.Generator,
    explained: float,
) -> Anchor | None:
    """Return the anchor that what a model leaves speaks for, or None.

    It must hold on blocks that it was not fitted to, and beat every cause of the library and every
    unknown structure that was found: where another explains as much, nothing is said.

    Parameters
    ----------
    explained : float
        Deviance that the accepted causes save: a small share of it may be their own inexactness.
    """
    problem = library.problem
    stack = problem.stack
    if not isinstance(problem.stage, PoseStage) or problem.stage.begins_anew:
        return None
    if POSITION[0] not in stack.edges:
        return None
    motion = Motion(problem, point)
    fields = anchor_fields(motion)
    columns = np.stack([motion.placed(*field.T) for field in fields], axis=1)
    bases = problem.bases(problem.nuisance(point.predicted, point.poses))
    white = problem.project(problem.whiten(columns), bases)
    white = orthogonal(white, problem.accepted(point))
    blocks = Blocks.of(stack.block, stack.n_blocks)
    scores = score(white[blocks.order], point.left[blocks.order], blocks)
    best = int(np.argmax(scores.gain))
    t, gain = abs(float(scores.t[best])), float(scores.gain[best])
    positions = sum(e.stop - e.start for n, e in stack.edges.items() if n in POSITION)
    if t < LEAST_T or gain < max(LEAST_GAIN, LEAST_SHARE * positions, INEXACT * explained):
        return None
    others = [u.gain for u in unknown if u.family.name != RANGING]
    if gain - TIE < max(_rival(library, point), *others, 0.0):
        return None
    p = float(adjusted(np.array([t]), null_maxima([scores], rng))[0])
    if p >= LEVEL or not holds_out(problem, white[:, [best]], point.left, LEAST_SAVED):
        return None
    half_m = 1.96 * float(scores.deviation[best] / scores.information[best])
    largest = float(np.hypot(*fields[best].T).max())
    p *= screen.LEVEL / LEVEL
    return Anchor(p, SIDES[best], float(scores.size[best]), half_m, largest)


def _rival(library: Library, point: Point) -> float:
    """Return the most that any cause of the library would save, less what it costs."""
    gain = library.scores(point).gain
    saved = (
        float(gain[library.owner == i].max()) - cost(c, 0.0)
        for i, c in enumerate(library.candidates)
        if c.cause != "nav_position_bias"
    )
    return max(saved, default=0.0)
