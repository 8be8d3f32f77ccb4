"""A look: which causes one window shows, and which of two models explains another better.

The base model is the running one without its terms. The search starts from the running terms and
estimates total values; a proposal is the change. A running term of which the window shows nothing
is kept; one that the window contradicts is dropped. Data may resolve more than matters: a change
counts only if its interval is further than the least change from the running value.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Final

import numpy as np

from hilserver.config.root import Config
from hilserver.daemon.assembly import assemble_config
from hilserver.diagnosis.catalogue.candidate import several
from hilserver.diagnosis.catalogue.vocabulary import (
    cause_of,
    part_of,
    reference,
    unit_of,
)
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.engine import judge
from hilserver.diagnosis.output import documents, write
from hilserver.diagnosis.regression.gain import HORIZON_S, gains
from hilserver.diagnosis.regression.problem import Point, Problem
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.model import Fitted, Model
from hilserver.diagnosis.schema.evidence import Diagnosis, FittedTerm
from hilserver.diagnosis.schema.findings import Finding, Overall, Verdict
from hilserver.errors import UserError
from hilserver.measured.data import MeasuredLog
from hilserver.measured.frames import Sampling
from hilserver.measured.reading import read_measured
from hilserver.parameters import geometric_gain, with_values
from hilserver.plant.parameters import RobotParameters
from hilserver.recalibration import flips
from hilserver.recalibration.orders import (
    JudgeOrder,
    JudgeResult,
    Looked,
    ModelsCompared,
    Values,
)
from hilserver.recalibration.proposals import ProposedTerm, Quantity, values_of
from hilserver.recalibration.spending import NAMED_LEVEL

# the same for both models, or the difference would be that of refinement
REFINED: Final = 3
HARMLESS: Final = frozenset({"dropouts", "limited_channel", "missed_ticks"})
"""Data faults that leave the remaining samples true: reported, but no reason to stop."""
PROPOSABLE: Final = (Verdict.NAMED, Verdict.NAMED_GROUP)
UNPROPOSED: Final = (Verdict.DRIFT, Verdict.EFFECTIVE)


class OrderJudge:
    """Does what an order asks for; reads the window once."""

    def __init__(self, order: JudgeOrder) -> None:
        self._order = order
        self._todo = order.todo
        config = Config.model_validate(order.config)
        assembly = assemble_config(config, Path(order.folder))
        self._config_sha256 = config.sha256
        self._sampling = Sampling.of(config)
        self._least_change = config.recalibration.least_change
        robot = assembly.robot
        if order.parameters:
            robot = with_values(robot, order.parameters, geometric_gain(robot))
        self.robot = robot

    @cached_property
    def log(self) -> MeasuredLog:
        """The window; LogError if it is damaged or has nothing to judge."""
        return read_measured([Path(self._order.path)], None, self._sampling)

    def result(self) -> JudgeResult:
        """Carry out the order; anything wrong with the window becomes the error sentence."""
        todo = self._todo
        measure = None
        confirm = None
        look = None
        try:
            if todo.measure is not None:
                measure = compared(self.log, self.robot, todo.measure, todo.loaded)
            if todo.confirm is not None:
                confirm = compared(self.log, self.robot, todo.loaded, todo.confirm)
            is_confirmed = confirm is not None and confirm.holds(todo.level)
            if todo.look and not is_confirmed:
                running = self._todo.loaded
                diagnosis = judge(
                    self.log,
                    self.robot,
                    config_sha256=self._config_sha256,
                    jobs=1,
                    running=running,
                )
                found = diagnosis.findings.findings
                faulty = [f for f in found if f.verdict is Verdict.DATA_FAULT]
                faults = tuple(f.explanation for f in faulty)
                if not all(set(f.causes) <= HARMLESS for f in faulty):
                    looked = Looked("data_fault", faults=faults)
                else:
                    remaining = [f for f in found if f not in faulty]
                    looked = replace(
                        self._named(diagnosis, remaining),
                        faults=faults,
                    )
                if looked.verdict == "named" and self._order.report:
                    write(Path(self._order.report), documents(diagnosis))
                look = looked
        except UserError as error:
            return JudgeResult(measure, confirm, error=str(error))
        return JudgeResult(measure, confirm, look)

    def _named(self, diagnosis: Diagnosis, found: list[Finding]) -> Looked:
        loaded = self._todo.loaded
        if diagnosis.findings.verdict is Overall.NOT_JUDGED:
            return Looked("not_judged")
        terms = self._with_running(
            proposed(steady(diagnosis), loaded, self._least_change)
        )
        values = values_of(terms)
        named = [f for f in found if f.verdict in PROPOSABLE]
        others = [f for f in found if f not in named]
        if values == dict(loaded):
            small = [f for f in named if not loaded.keys() & f.parameters.keys()]
            return self._unchanged(others, small)
        again = compared(self.log, self.robot, loaded, values)
        if not again.holds(self._level(terms)):
            return replace(self._unchanged(others), p=again.p)
        gone = {name: value for name, value in loaded.items() if name not in values}
        changed = {name for name, value in values.items() if value != loaded.get(name)}
        new = [f for f in named if changed & f.parameters.keys()]
        sentence = sentence_of(new) or f"No longer present: {', '.join(sorted(gone))}."
        causes = tuple(cause for f in new for cause in f.causes) or tuple(sorted(gone))
        fitted = diagnosis.evidence.fitted.model_dump(mode="json", exclude_none=True)
        return Looked(
            "named",
            sentence,
            causes,
            terms,
            gone,
            fitted,
            p=again.p,
        )

    def _unchanged(
        self, others: Sequence[Finding], small: Sequence[Finding] = ()
    ) -> Looked:
        """Return the verdict if nothing is proposed: findings without a term, or too small."""
        if others:
            return Looked("unexplained", sentence_of(others))
        if small:
            causes = tuple(cause for f in small for cause in f.causes)
            return Looked("too_small", sentence_of(small), causes)
        return Looked("as_running" if self._todo.loaded else "nothing")

    def _with_running(self, found: dict[str, ProposedTerm]) -> dict[str, ProposedTerm]:
        """Add the running terms that were not found; drop a cause that makes this window worse.

        Parameters
        ----------
        found : dict of Term
            Terms for which the diagnosis has a value.
        """
        loaded = self._todo.loaded
        unseen = {
            n: ProposedTerm(v, unit_of(n), None, v)
            for n, v in loaded.items()
            if n not in found
        }
        terms = {**found, **unseen}
        level = self._level(terms)
        for cause in sorted({cause_of(name).name for name in unseen}):
            own = {n: t for n, t in unseen.items() if cause_of(n).name == cause}
            # Is a running cause large enough that its absence would be seen?
            shows = any(
                is_changed(name, term, part_of(name).null, self._least_change)
                for name, term in own.items()
                if not part_of(name).shape
            )
            if not shows:
                continue
            less = {n: t for n, t in terms.items() if n not in own}
            again = compared(self.log, self.robot, values_of(terms), values_of(less))
            terms = less if again.holds(level) else terms
        return terms

    def _level(self, terms: Mapping[str, ProposedTerm]) -> float:
        """Return the level of each comparison of a look, of which there may be one per term."""
        n_judged = max(len({*terms, *self._todo.loaded}), 1)
        return NAMED_LEVEL / (2 * n_judged)


def sentence_of(findings: Sequence[Finding]) -> str:
    """Join the explanations of findings."""
    return " ".join(f.explanation for f in findings)


def steady(diagnosis: Diagnosis) -> list[FittedTerm]:
    """Return the terms with a name and one value for the whole window: a drift has none.

    What only acts like a cause is for an engineer to judge.
    """
    found = [f for f in diagnosis.findings.findings if f.verdict in UNPROPOSED]
    barred = {name for f in found for name in f.parameters}
    return [
        fitted for fitted in diagnosis.evidence.extension if fitted.name not in barred
    ]


def proposed(
    found: Iterable[FittedTerm], loaded: Values, least_change: float
) -> dict[str, ProposedTerm]:
    """Return the terms that were found; one that changes too little keeps its present value.

    A cause that is off stays off unless one of its sizes has changed.
    """
    causes: dict[str, dict[str, ProposedTerm]] = {}
    for fitted in found:
        p = fitted.parameter
        name = fitted.name
        own = causes.setdefault(cause_of(name).name, {})
        own[name] = ProposedTerm(p.value, p.unit, p.ci95, loaded.get(name))
    terms: dict[str, ProposedTerm] = {}
    for own in causes.values():
        changed = {
            n for n, t in own.items() if is_changed(n, t, now_of(n, t), least_change)
        }
        has_changed = any(not part_of(name).shape for name in changed)
        for name, term in own.items():
            if has_changed and name in changed:
                terms[name] = term
            elif term.present is not None:
                terms[name] = replace(term, value=term.present)
    return terms


def now_of(name: str, term: ProposedTerm) -> float | None:
    """Return the present value of a term; None if it is off and has no neutral value."""
    return part_of(name).null if term.present is None else term.present


def is_changed(
    name: str, term: ProposedTerm, now: float | None, least_change: float
) -> bool:
    """Return whether the interval of a term is further than the least change from a value.

    Parameters
    ----------
    now : float or None
        See `now_of`.
    least_change : float
        By the reference size of its cause; of a shape every change counts.
    """
    if now is None:
        return True
    low, high = term.interval
    size = None if part_of(name).shape else reference(cause_of(name).name, name)
    least = least_change * (size or 0.0)
    return not low - least <= now <= high + least


def fixed(values: Values) -> Model:
    """Return the model with these terms, and nothing that is fitted."""
    if not values:
        return Model()
    return Model((Fitted(several("patch", "patch", "pose", (), (), 0.0, values), ()),))


def compared(
    log: MeasuredLog, robot: RobotParameters, before: Values, after: Values
) -> ModelsCompared:
    """Compare two models, neither of which has seen a log, block by block.

    The noise is that which the model before leaves: it may hide a gain, and never makes one.
    """
    log = check(log, robot).log
    rng = np.random.default_rng(0)
    differences = [np.zeros(0)]
    shown = [np.zeros(0)]
    gain: dict[str, Quantity] = {}
    for stage in stages_of(log, robot, drive_terms=after).values():
        problem = Problem(stage.uncut())
        if not len(problem.stack):
            continue
        first, second = _points(problem, fixed(before), fixed(after))
        differences.append(first.loss - second.loss)
        shown.append(problem.stack.block_sums((first.left - second.left) ** 2))
        found = gains(problem, first.predicted, second.predicted, HORIZON_S, rng)
        gain |= {
            n: Quantity(g.before, g.after, g.ratio, g.ci95) for n, g in found.items()
        }
    seen = flips.seen(np.concatenate(differences), np.concatenate(shown))
    return ModelsCompared(**asdict(flips.gains(seen, rng)), gain=gain)


def _points(problem: Problem, before: Model, after: Model) -> tuple[Point, Point]:
    poses = problem.start_poses(before.terms)
    problem.estimate_noise(problem.residual(problem.predict(before.terms, poses)))
    first = problem.point(before, poses, pose_steps=REFINED)
    problem.estimate_noise(problem.residual(first.predicted))
    first, second = (
        problem.point(model, problem.start_poses(model.terms), pose_steps=REFINED)
        for model in (before, after)
    )
    return first, second
