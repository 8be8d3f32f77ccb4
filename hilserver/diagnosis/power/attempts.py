"""Known effects, one at a time and at several sizes, each put into a recording and diagnosed."""

import time
from collections.abc import Callable, Generator, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Final, Literal

import numpy as np
from scipy import stats

from hilserver.diagnosis.catalogue.candidate import Candidate
from hilserver.diagnosis.decide import one_topic
from hilserver.diagnosis.engine import judge
from hilserver.diagnosis.memory import reuse_memory
from hilserver.diagnosis.pipeline import Task, opened
from hilserver.diagnosis.plan.information import T_NEEDED
from hilserver.diagnosis.power.effects import with_effect
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.judgeable import judged_candidates, splits
from hilserver.diagnosis.replay.model import Fitted
from hilserver.diagnosis.schema.findings import Detectable, Verdict
from hilserver.diagnosis.thresholds import DETECTABLE_POWER_SD
from hilserver.errors import UserError
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.plant.parameters import RobotParameters

TIMES_SMALLEST: Final = (1.0, 2.0, 0.5, 1.4, 0.7)
"""Sizes that are tried, as multiples of `smallest_detectable`, in this order."""
NAMING: Final = (Verdict.NAMED, Verdict.NAMED_GROUP, Verdict.DATA_FAULT)

Outcome = Literal["named", "group", "seen", "nothing", "failed"]
"""Its name alone; its name beside others; something else was found; nothing; no diagnosis."""


@dataclass(frozen=True)
class Attempt:
    """One effect to put into a recording; travels to other processes."""

    task: Task
    label: str  # of the candidate; empty: the recording as it is
    cause: str = ""
    unit: str = ""
    smallest: float = 0.0  # `smallest_detectable` of its cause
    times: float = 0.0  # how strong it is, as a multiple of that
    # distance of the parameter from having no effect; of a limit, its value
    size: float = 0.0
    value: float = 0.0  # of its parameter

    @property
    def predicted(self) -> float:
        """Probability of a finding with its name, as the diagnosis of the recording predicts it."""
        return float(
            stats.norm.cdf(T_NEEDED * (self.times - 1.0) + DETECTABLE_POWER_SD)
        )


@dataclass(frozen=True)
class AttemptOutcome:
    """What the diagnosis says of an attempt."""

    found: tuple[tuple[str, tuple[str, ...]], ...] = ()  # verdicts and causes
    smallest: tuple[Detectable, ...] = ()
    error: str = ""

    @property
    def causes(self) -> set[str]:
        """All that a finding names, alone or in a group."""
        return {cause for _, names in self.found for cause in names}


@lru_cache(maxsize=1)
def recording(task: Task) -> tuple[MeasuredLog, RobotParameters, RobotParameters]:
    """Return the log of a task without its faults, the configured robot and that of the log."""
    log, robot = opened(task)
    own = machine(log, robot)
    return one_topic.checked(log, own).log, robot, own


@lru_cache(maxsize=1)
def possible(task: Task) -> Mapping[str, Candidate]:
    """Return what can be put into the log of a task, by stage and label."""
    log, _, own = recording(task)
    return {
        f"{stage.name}: {candidate.label}": candidate
        for stage in stages_of(log, own).values()
        for candidate in judged_candidates(stage)[0]
        if splits(log, candidate)
    }


def attempted(attempt: Attempt) -> AttemptOutcome:
    """Put an effect into the recording and diagnose it."""
    reuse_memory()
    try:
        log, robot, own = recording(attempt.task)
        if attempt.label:
            candidate = possible(attempt.task)[attempt.label]
            others = candidate.null[1:]
            log = with_effect(log, own, Fitted(candidate, (attempt.value, *others)))
        found = judge(log, robot, seed=attempt.task.seed, jobs=1).findings
    except UserError as error:
        return AttemptOutcome(error=str(error))
    said = [
        (one.verdict.value, one.causes)
        for one in found.findings
        if one.verdict is not Verdict.INSUFFICIENT_EXCITATION
    ]
    return AttemptOutcome(tuple(said), found.smallest_detectable)


def attempts_of(
    task: Task, control: AttemptOutcome, causes: Sequence[str] = ()
) -> list[Attempt]:
    """Return what to try, the most telling sizes of all causes first.

    What the recording shows already is left out: another such effect would tell nothing.

    Parameters
    ----------
    control : AttemptOutcome
        Of the recording as it is.
    causes : sequence of str, optional
        Only these.
    """
    rng = np.random.default_rng(task.seed)
    already = control.causes
    by_cause: dict[str, list[str]] = {}
    for label, candidate in possible(task).items():
        by_cause.setdefault(candidate.cause, []).append(label)

    found = []
    for times in TIMES_SMALLEST:
        for one in control.smallest:
            wanted = one.cause not in already and (not causes or one.cause in causes)
            if not wanted or one.cause not in by_cause:
                continue
            label = str(rng.choice(by_cause[one.cause]))
            candidate = possible(task)[label]
            # a smaller limit does more
            size = one.size / times if candidate.is_limit else one.size * times
            value = _value(candidate, size, rng)
            if value is not None:
                found.append(
                    Attempt(
                        task,
                        label,
                        one.cause,
                        one.unit,
                        smallest=one.size,
                        times=times,
                        size=size,
                        value=value,
                    )
                )
    return found


def _value(candidate: Candidate, size: float, rng: np.random.Generator) -> float | None:
    """Return the parameter of an effect of some size, of either sign; None if none is possible."""
    low, high, null = candidate.low[0], candidate.high[0], candidate.null[0]
    values = [size] if candidate.is_limit else [null + size, null - size]
    able = [value for value in values if low <= value <= high]
    return float(rng.choice(able)) if able else None


def outcome_of(
    attempt: Attempt, result: AttemptOutcome, control: AttemptOutcome
) -> tuple[Outcome, tuple[str, ...]]:
    """Return whether an effect was found, and wrong names: those of findings that it has caused."""
    if result.error:
        return "failed", ()
    named = [names for verdict, names in result.found if verdict in NAMING]
    right = [names for names in named if attempt.cause in names]
    expected = {attempt.cause, *control.causes}
    wrong = [names for names in named if not expected & {*names}]
    said = tuple(name for names in wrong for name in names)
    if right:
        return ("named" if len(right[0]) == 1 else "group"), said
    new = [names for names in result.found if names not in control.found]
    return ("seen" if new else "nothing"), said


def until(
    results: Iterable[tuple[int, AttemptOutcome]],
    limit_s: float,
    clock: Callable[[], float] = time.monotonic,
) -> Generator[tuple[int, AttemptOutcome], None, None]:
    """Yield results until a time is over; what runs then is not waited for."""
    end_s = clock() + limit_s
    for index, result in results:
        yield index, result
        if clock() > end_s:
            return
