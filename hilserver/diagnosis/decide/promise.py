"""What no step may make worse: the error at the end of free runs on held-out blocks."""

import numpy as np
from scipy import stats

from hilserver.diagnosis.regression.gain import (
    HORIZON_S,
    Pair,
    crossed,
    errors,
    held_out,
)
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.schema.decisions import Action, Decision
from hilserver.diagnosis.thresholds import (
    CLEARLY_SE,
    EFFECTIVE_LEVEL,
    NEGLIGIBLE,
)


class ModelExchange:
    """The exchange of one model for another, compared block by block on held-out blocks.

    Parameters
    ----------
    before, after : Point
        Both are fitted on each half of the blocks and predict the other half.
    """

    def __init__(self, problem: Problem, before: Point, after: Point) -> None:
        predicted = [
            held_out(problem, crossed(problem, p, p.model)) for p in (before, after)
        ]
        self._pairs = errors(problem, (predicted[0], predicted[1]), HORIZON_S)

    @property
    def gain(self) -> float | None:
        """Error before over error after, geometric mean over the quantities; None without any."""
        ratios = [
            pair.before.values.mean() / max(pair.after.values.mean(), 1e-300)
            for pair in self._pairs.values()
        ]
        return float(np.exp(np.mean(np.log(ratios)))) if ratios else None

    @property
    def harms(self) -> bool:
        """Whether a reported error grows clearly."""
        return any(map(_grows, self._pairs.values()))

    @property
    def helps(self) -> bool:
        """Whether a reported error falls clearly."""
        return any(
            _grows(Pair(p.after, p.before, p.horizon_s)) for p in self._pairs.values()
        )

    @property
    def earns(self) -> bool:
        """Whether a reported error falls, as `effective` items must."""
        return any(map(falls, self._pairs.values()))


def left_out(
    problem: Problem, before: Point, after: Point, action: Action, reason: str
) -> list[Decision]:
    """Return a row for each cause that the next model no longer has, with the gain of the step."""
    gone = [c for c in before.model.causes if c not in after.model.causes]
    gain = ModelExchange(problem, before, after).gain if gone else None
    return [Decision(cause, action, gain, reason) for cause in gone]


def falls(pair: Pair) -> bool:
    """Return whether an error falls by more than chance, on a paired t test over the blocks."""
    blocks = len(np.unique(pair.before.block))
    clear_se = float(stats.t.isf(EFFECTIVE_LEVEL, max(blocks - 1, 1)))
    return _grows(Pair(pair.after, pair.before, pair.horizon_s), clear_se)


def _grows(pair: Pair, clear_se: float = CLEARLY_SE) -> bool:
    more = pair.after.values - pair.before.values
    block = pair.before.block
    count = np.bincount(block)
    of_block = np.bincount(block, weights=more)[count > 0]
    scatter = of_block - count[count > 0] * more.mean()
    clear = more.sum() > clear_se * float(np.sqrt((scatter**2).sum()))
    return bool(clear and more.mean() > NEGLIGIBLE * pair.before.values.mean())
