"""What each cause is worth on held-out blocks: alone, and with its possible substitutes."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.decide.revision import JudgedStage
from hilserver.diagnosis.findings.estimate import StageEstimate
from hilserver.diagnosis.regression.gain import (
    Pair,
    channel_errors,
    errors,
    pooled_gains,
)
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.findings import Finding, Gain, Matters

Predictions = tuple[Array, ...]  # one for each member


@dataclass(frozen=True)
class MemberStage:
    """One stage of one member."""

    member: str
    judged: JudgedStage
    # held-out predictions: the configured plant; the same with the log corrected; with all causes
    before: Array
    corrected: Array
    after: Array

    @property
    def problem(self) -> Problem:
        """Its regression problem."""
        return self.judged.prepared.problem

    def errors(self, before: Array, horizon_s: float) -> dict[str, Pair]:
        """Return the errors of every quantity for a given prediction, and with all causes."""
        return errors(self.problem, (before, self.after), horizon_s)


@dataclass(frozen=True)
class Explained:
    """What the causes of one stage explain, of one member or of several."""

    parts: tuple[MemberStage, ...]
    # predictions of the model without some of its causes, which are given by index
    without: Callable[[frozenset[int]], Predictions]

    @property
    def corrected(self) -> Predictions:
        """Predictions of the configured plant with the log, its clock, corrected by the causes."""
        return tuple(part.corrected for part in self.parts)

    def gains(
        self,
        horizon_s: float,
        rng: np.random.Generator,
        before: Predictions | None = None,
    ) -> dict[str, Gain]:
        """Return the gain of every quantity over all members, against no cause or against some."""
        base = before or tuple(part.before for part in self.parts)
        pairs = [p.errors(b, horizon_s) for p, b in zip(self.parts, base, strict=True)]
        return pooled_gains(pairs, rng)

    def matters(self, alone: Predictions, together: Predictions) -> dict[str, Matters]:
        """Return by how much the error of every channel falls."""
        least = self._means([part.after for part in self.parts])
        more, most = self._means(alone), self._means(together)
        return {
            name: Matters(
                alone=_ratio(more[name], least[name]),
                with_partners=_ratio(most[name], least[name]),
            )
            for name in least
        }

    def _means(self, predictions: Sequence[Array]) -> dict[str, float]:
        """Return the mean absolute error of every channel, with free initial poses."""
        values: dict[str, list[Array]] = {}
        for part, predicted in zip(self.parts, predictions, strict=True):
            for name in part.problem.stack.channels:
                found = channel_errors(part.problem, predicted, (name,))
                if found is not None:
                    values.setdefault(name, []).append(found.values)
        return {
            name: float(np.concatenate(parts).mean()) for name, parts in values.items()
        }


def _ratio(before: float, after: float) -> float:
    return 1.0 if before == after else before / max(after, 1e-300)


@dataclass(frozen=True)
class StageAnswer:
    """The answer of one stage of all members."""

    # with all that predicts, and with what a patch holds alone
    explained: Explained
    patch: Explained
    model: Model  # what a patch holds
    findings: tuple[Finding, ...]  # one per cause, in the order of the model
    estimate: StageEstimate  # all parameters of the model

    def patch_gains(
        self, horizon_s: float, rng: np.random.Generator, whole: dict[str, Gain]
    ) -> dict[str, Gain]:
        """Return the gain of the patch, against the configured plant with the log corrected.

        Parameters
        ----------
        whole : dict of str to Gain
            That of all that predicts: the same if it is all in the patch and corrects no log.
        """
        corrected = self.patch.corrected
        before = [part.before for part in self.patch.parts]
        same = all(map(np.array_equal, corrected, before))
        if same and self.patch is self.explained:
            return whole
        return self.patch.gains(horizon_s, rng, corrected)

    def possible(self, horizon_s: float, rng: np.random.Generator) -> dict[str, Gain]:
        """Return what predicts without any claim adds to the patch, by quantity that it changes."""
        if self.explained is self.patch:
            return {}
        patched = tuple(part.after for part in self.patch.parts)
        beside = self.explained.gains(horizon_s, rng, patched)
        return {key: gain for key, gain in beside.items() if gain.before != gain.after}

    def with_worth(
        self,
        horizon_s: float,
        rng: np.random.Generator,
        total: dict[str, Gain] | None = None,
    ) -> list[Finding]:
        """Return the findings with the gain of each cause and its effect, all others being on.

        Parameters
        ----------
        total : dict of str to Gain, optional
            The gain of all causes, if known; it is also that of a single cause.
        """
        found = []
        for index, finding in enumerate(self.findings):
            alone = self.explained.without(frozenset({index}))
            partners = self.estimate.partners(index)
            together = self.explained.without(partners | {index}) if partners else alone
            only = total if len(self.findings) == 1 else None
            gain = only or self.explained.gains(horizon_s, rng, alone)
            matters = self.explained.matters(alone, together)
            found.append(finding.model_copy(update={"gain": gain, "matters": matters}))
        return found
