"""The gain on logs that took no part in selection or fit."""

import math
from collections.abc import Container, Mapping
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.vocabulary import cause_of
from hilserver.diagnosis.findings.outcome import effective
from hilserver.diagnosis.findings.worth import StageAnswer
from hilserver.diagnosis.regression.gain import Pair, errors, gains, pooled_gains
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.findings import Finding, Gain, Verdict
from hilserver.diagnosis.thresholds import NEGLIGIBLE
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

FEWEST_RUNS: Final = 4
LONGEST_RUN_S: Final = 300.0


@dataclass(frozen=True)
class OtherLogs:
    """Other logs, and models of the stages that are judged by them.

    If the logs consist of several runs, free runs go from the beginning of each to its end.
    """

    problems: Mapping[str, Problem]  # by stage
    models: Mapping[str, Model]
    horizon_s: float

    @classmethod
    def of(
        cls,
        log: MeasuredLog,
        robot: RobotParameters,
        models: Mapping[str, Model],
        horizon_s: float,
    ) -> "OtherLogs":
        """Prepare the stages of a log."""
        lengths = [s.end_s - s.start_s for s in log.spans]
        if len(lengths) >= FEWEST_RUNS and max(lengths) <= LONGEST_RUN_S:
            horizon_s = math.inf
        known = models["drive"].terms if "drive" in models else {}
        stages = stages_of(log, robot, drive_terms=known)
        problems = {name: Problem(stage.uncut()) for name, stage in stages.items()}
        return cls(problems, models, horizon_s)

    def gains(
        self, rng: np.random.Generator, *, of_patch: bool = False
    ) -> dict[str, Gain]:
        """Return what the models gain.

        Parameters
        ----------
        of_patch : bool
            Also correct the log when replaying the configured plant: no patch does that.
        """
        found: dict[str, Gain] = {}
        for name, problem in self.problems.items():
            model = self.models.get(name, Model())
            base = model.without(*model.of_the_machine) if of_patch else Model()
            before, after = (_predicted(problem, m) for m in (base, model))
            found |= gains(problem, before, after, self.horizon_s, rng)
        return found

    def unconfirmed(self, rng: np.random.Generator) -> frozenset[str]:
        """Return the causes that change what is predicted, but for which nothing clearly improves.

        A cause that these logs do not excite changes nothing, and remains what it is.
        """
        found = set()
        for name, problem in self.problems.items():
            model = self.models.get(name, Model())
            after = _predicted(problem, model)
            for index in sorted(model.of_the_machine):
                before = _predicted(problem, model.without(index))
                pairs = errors(problem, (before, after), self.horizon_s)
                gain = pooled_gains([pairs], rng).values()
                changes = any(map(_changes, pairs.values()))
                is_known = any(g.ci95 is not None for g in gain)
                clear = any(g.ci95 is not None and g.ci95[0] > 1.0 for g in gain)
                if changes and is_known and not clear:
                    found.add(model.causes[index])
        return frozenset(found)


def a_rung_lower(answer: StageAnswer, causes: Container[str]) -> StageAnswer:
    """Return an answer in which some causes have lost their names, but not their part in it."""
    own = zip(answer.model.causes, answer.findings, strict=True)
    findings = [_nameless(f, cause) if cause in causes else f for cause, f in own]
    return replace(answer, findings=tuple(findings))


def _nameless(finding: Finding, cause: str) -> Finding:
    if finding.verdict not in (Verdict.NAMED, Verdict.NAMED_GROUP):
        return finding
    values = {n: v for n, v in finding.parameters.items() if cause_of(n).name == cause}
    return effective(cause, values, finding.p_adjusted or 0.0)


def _predicted(problem: Problem, model: Model) -> Array:
    return problem.predict(model.terms, problem.start_poses(model.terms))


def _changes(pair: Pair) -> bool:
    before, after = pair.before.values, pair.after.values
    return bool(np.abs(after - before).mean() > NEGLIGIBLE * before.mean())
