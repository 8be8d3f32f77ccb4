"""What each cause is worth on held-out blocks: alone, and with those that could stand in for it."""

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from hilserver.diagnosis.findings.estimate import Estimate
from hilserver.diagnosis.regression.gain import channel_errors, errors, pooled_gains
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.findings import Finding, Gain, Matters
from hilserver.measured.arrays import Array

Predictions = tuple[Array, ...]


@dataclass(frozen=True)
class Explained:
    """What the causes of one stage explain, of one set of logs or of several.

    Attributes
    ----------
    problems : tuple of Problem
    before, after : tuple of ndarray
        Predictions of each problem without any cause, and with all of them.
    without : callable
        Predictions of the model without some of its causes, by their places in it.
    """

    problems: tuple[Problem, ...]
    before: Predictions
    after: Predictions
    without: Callable[[frozenset[int]], Predictions]

    def gains(
        self, before: Predictions, horizon_s: float, rng: np.random.Generator
    ) -> dict[str, Gain]:
        """Return the gain of every quantity over all problems."""
        return pooled_gains(
            [
                errors(p, (b, a), horizon_s)
                for p, b, a in zip(self.problems, before, self.after, strict=True)
            ],
            rng,
        )

    def matters(self, alone: Predictions, together: Predictions) -> dict[str, Matters]:
        """Return by how much the error of every channel falls."""
        least = self._means(self.after)
        more, most = self._means(alone), self._means(together)
        return {
            name: Matters(
                alone=_ratio(more[name], least[name]), with_partners=_ratio(most[name], least[name])
            )
            for name in least
        }

    def _means(self, predictions: Predictions) -> dict[str, float]:
        """Return the mean absolute error of every channel, initial poses free."""
        values: dict[str, list[Array]] = {}
        for problem, predicted in zip(self.problems, predictions, strict=True):
            for name in problem.stack.channels:
                found = channel_errors(problem, predicted, (name,))
                if found is not None:
                    values.setdefault(name, []).append(found.values)
        return {name: float(np.concatenate(parts).mean()) for name, parts in values.items()}


def _ratio(before: float, after: float) -> float:
    return 1.0 if before == after else before / max(after, 1e-300)


def without_causes(model: Model, causes: Iterable[int]) -> Model:
    """Return a model without some of its causes."""
    for index in sorted(causes, reverse=True):
        model = model.without(index)
    return model


def with_worth(
    finding: Finding,
    index: int,
    whole: Explained,
    estimate: Estimate,
    horizon_s: float,
    rng: np.random.Generator,
    total: dict[str, Gain] | None = None,
) -> Finding:
    """Add what one cause gains and how it matters: all others on, with and without it.

    Parameters
    ----------
    index : int
        Place of the cause in the model.
    total : dict of str to Gain, optional
        The gain of the whole model, where this is its only cause.
    """
    n = max(estimate.owner) + 1
    alone = whole.without(frozenset({index}))
    partners = estimate.partners(index)
    together = whole.without(partners | {index}) if partners else alone
    gain = total if n == 1 and total is not None else whole.gains(alone, horizon_s, rng)
    matters = whole.matters(alone, together)
    return finding.model_copy(update={"gain": gain, "matters": matters})
