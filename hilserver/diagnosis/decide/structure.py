"""Unknown structure: what remains after the library, without a name."""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.decide.unknown import Family
from hilserver.diagnosis.regression.columns import RIDGE
from hilserver.diagnosis.regression.fitting import fit_without
from hilserver.diagnosis.regression.linear import (
    cosine,
    orthogonal,
    ridge,
    saved,
    scaled,
)
from hilserver.diagnosis.regression.problem import Point, Problem, apart
from hilserver.diagnosis.regression.screen import (
    Blocks,
    adjusted,
    critical,
    least_t,
    null_maxima,
    score,
)
from hilserver.diagnosis.thresholds import (
    DOMINANCE,
    FEWEST_BLOCKS,
    GROSS,
    INEXACT,
    LEAST_USEFUL,
    LEFT_SHARE,
    OUTLIER_SD,
    REST_LEAST_GAIN,
    REST_LEVEL,
    RIVAL_COSINE,
)


@dataclass(frozen=True)
class Unknown:
    """A family of columns that the remaining error depends on."""

    family: Family  # without what the accepted causes explain
    t: float
    critical: float  # what t must exceed, among all families
    p: float
    gain: float  # deviance that the whole family saves, minus one per column


def remaining(
    problem: Problem,
    point: Point,
    rng: np.random.Generator,
    families: Iterable[Family],
    explained: float,
) -> list[Unknown]:
    """Return the families that the residual significantly depends on, the strongest first.

    Parameters
    ----------
    explained : float
        Deviance saved by the accepted causes, whose inexactness may leave a small share of it.

    Notes
    -----
    A gross misfit of a model without any cause is always reported: if no family is significant,
    because the misfit is in few blocks, the one that explains most is returned. Single samples that
    are far off, such as those of a slow sensor near a step, are no gross misfit.
    """
    stack, accepted = problem.stack, problem.accepted(point)
    blocks = Blocks.of(stack.block, stack.n_blocks)
    bounded = np.minimum(point.left**2, OUTLIER_SD**2)
    misfit = float(bounded.mean())
    # a set-point may have come and gone between two rows, which few blocks show
    if problem.stage.follows_setpoints:
        count = np.bincount(stack.block, minlength=stack.n_blocks)
        sums = stack.block_sums(bounded)
        misfit = float(np.median(sums[count > 0] / count[count > 0]))
    blank = not point.model.fitted and stack.n_blocks >= FEWEST_BLOCKS
    gross = blank and misfit > GROSS
    least = max(REST_LEAST_GAIN, LEAST_USEFUL * len(stack), INEXACT * explained)
    scores, strong = [], []
    most: Unknown | None = None
    for family in families:
        white = orthogonal(family.white, accepted)
        white[:, (white**2).sum(axis=0) < 1e-4 * (family.white**2).sum(axis=0)] = 0.0
        scores.append(score(white[blocks.order], point.left[blocks.order], blocks))
        t = float(np.abs(scores[-1].t).max(initial=0.0))
        if t <= least_t(REST_LEVEL) and not gross:
            continue
        gain = joint_gain(white, point.left)
        u = Unknown(replace(family, white=white), t, np.inf, 1.0, gain)
        if gross and (most is None or u.gain > most.gain):
            most = u
        if (
            t > least_t(REST_LEVEL)
            and u.gain > least
            and holds_out(problem, white, point.left)
        ):
            strong.append(u)
    maxima = null_maxima(scores, rng)
    limit, ps = (
        critical(maxima, REST_LEVEL),
        adjusted(np.array([u.t for u in strong]), maxima),
    )
    found = [
        replace(u, p=float(p))
        for u, p in zip(strong, ps, strict=True)
        if p < REST_LEVEL
    ]
    if not found and most is not None:
        found = [most]
    return [replace(u, critical=limit) for u in sorted(found, key=lambda u: -u.gain)]


class Imitation:
    """The accepted cause that columns of unknown structure most clearly outdo.

    Compared on blocks that neither was fitted to, without what the other causes explain. Only
    columns that could stand in its place count: those like it, and those beside which nothing is
    left for it to explain. Others explain something else, which may well be more. A column that is
    slightly better may be a twin of the cause, since it is linear and the form of the cause exact.
    One cause at a time: without it, the next may be needed.
    """

    def __init__(self, problem: Problem, point: Point) -> None:
        self._problem, self._point = problem, point
        self._better = np.zeros(len(point.model.fitted))

    def beside(self, families: Iterable[Family]) -> Iterator[Family]:
        """Yield families one at a time, each compared with every cause."""
        accepted = self._problem.accepted(self._point)
        for family in families:
            for index in range(len(self._better)):
                assert accepted is not None
                more = _better(
                    self._problem, family.white, self._point, accepted, index
                )
                self._better[index] = max(self._better[index], more)
            yield family

    @property
    def index(self) -> int | None:
        """Its index among the causes, or None."""
        return int(np.argmax(self._better)) if self._better.any() else None


def imitated(problem: Problem, point: Point, families: Iterable[Family]) -> int | None:
    """Return the index of an accepted cause that is imitated, see `Imitation`, or None."""
    if not point.model.fitted:
        return None
    found = Imitation(problem, point)
    for _ in found.beside(families):
        pass
    return found.index


def _better(
    problem: Problem, white: Array, point: Point, accepted: Array, index: int
) -> float:
    """Return by how much a family's columns explain more in place of a cause; or 0.

    As many as the cause has parameters: a wave needs two, whatever its phase.
    """
    others, own = apart(point, accepted, index)
    target = orthogonal(point.left + own, others)
    effect = orthogonal(own[:, None], others)
    columns = orthogonal(white, others)
    squares = (columns**2).sum(axis=0)
    columns = columns[:, squares > 1e-4 * (white**2).sum(axis=0) + 1e-12]
    if not columns.shape[1]:
        return 0.0

    explained = saved_held_out(problem, effect, target)
    alike = [c for c in columns.T if cosine(c, effect[:, 0]) > RIVAL_COSINE]
    most = max(
        (saved_held_out(problem, c[:, None], target) for c in alike), default=0.0
    )

    together = _strongest(columns, target, len(point.model.fitted[index].theta))
    both = saved_held_out(problem, together, target)
    beside = saved_held_out(problem, np.column_stack([together, effect]), target) - both
    if beside < LEFT_SHARE * explained:
        most = max(most, both)
    return max(most - explained * (1.0 + INEXACT) - REST_LEAST_GAIN, 0.0)


def _strongest(columns: Array, target: Array, count: int) -> Array:
    """Return the columns that explain most of a target, each beside those before it."""
    chosen: list[int] = []
    for _ in range(min(count, columns.shape[1])):
        taken = columns[:, chosen]
        left = orthogonal(columns, taken)
        length = np.sqrt((left**2).sum(axis=0))
        new = length > 1e-3 * np.sqrt((columns**2).sum(axis=0))
        along = np.abs(left.T @ orthogonal(target, taken)) / (length + 1e-300)
        chosen.append(int(np.argmax(np.where(new, along, -1.0))))
    return columns[:, chosen]


def saved_held_out(problem: Problem, columns: Array, target: Array) -> float:
    """Return the deviance that columns together save on blocks they were not fitted to."""
    fold, total = problem.stack.fold[problem.stack.block], 0.0
    for test in (0, 1):
        size = ridge(columns[fold != test], target[fold != test])
        aim = target[fold == test]
        rest = aim - columns[fold == test] @ size
        total += float(aim @ aim - rest @ rest)
    return total


def joint_gain(white: Array, left: Array) -> float:
    """Return the deviance that all columns save together, minus one per column."""
    shown = white[:, white.any(axis=0)]
    return saved(shown, left, RIDGE) - float(shown.shape[1])


def holds_out(
    problem: Problem, white: Array, left: Array, least: float = REST_LEAST_GAIN
) -> bool:
    """Return whether a family explains blocks that its coefficients were not fitted to."""
    stack = problem.stack
    unit, _ = scaled(white)
    gained = []
    fold = stack.fold[stack.block]
    for test in (0, 1):
        train = fold != test
        if not train.any() or train.all():
            return False
        a, b = unit[train], left[train]
        gram = a.T @ a + 0.02 * np.eye(unit.shape[1])
        rest = left - unit @ np.linalg.solve(gram, a.T @ b)
        part = stack.fold == test
        gained.append(float(stack.block_sums(left**2 - rest**2)[part].sum()))
    return sum(gained) > least and min(gained) > 0.0


def beside_structure(
    problem: Problem, point: Point, unknown: Sequence[Unknown]
) -> Array:
    """Return the variance of every whitened sample that is noise: what structure leaves, at most 1.

    A misfit of some seconds passes for noise of its channel, and then hides how large it is.
    """
    noise = np.ones(len(point.left))
    if not unknown:
        return noise
    columns, _ = np.linalg.qr(unknown[0].family.white + 1e-12)
    rest = point.left - columns @ (columns.T @ point.left)
    for edge in problem.stack.edges.values():
        if edge.stop > edge.start:
            noise[edge] = min(float(np.mean(rest[edge] ** 2)), 1.0)
    return noise


def without_unknown(
    problem: Problem, point: Point, unknown: Sequence[Unknown]
) -> list[int]:
    """Return the accepted causes that unknown structure leaves in doubt.

    A cause is in doubt if, together with the structure's columns, it explains less than
    `DOMINANCE` times what the structure does; or if the structure explains more in its place.
    """
    if not unknown or not point.model.fitted:
        return []
    columns = np.concatenate([u.family.white for u in unknown[:2]], axis=1)
    base, _ = np.linalg.qr(columns + 1e-12)
    doubtful = []
    strength = max(u.gain for u in unknown)
    for index in range(len(point.model.fitted)):
        reduced = fit_without(problem, point, index)
        rest = reduced.left - base @ (base.T @ reduced.left)
        full = point.left - base @ (base.T @ point.left)
        own = float((rest**2).sum() - (full**2).sum())
        instead = float((rest**2).sum()) + columns.shape[1] < point.deviance
        if own < DOMINANCE * strength or instead:
            doubtful.append(index)
    return doubtful
