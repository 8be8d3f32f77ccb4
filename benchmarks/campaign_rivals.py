"""Answers of rivals of the diagnosis on the logs of the campaign, next to its own."""

from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import numpy as np
from hilserver_injector.cases import Case

from benchmarks import sindy, sysid
from benchmarks.baselines import RIVALS, applies
from benchmarks.diagnose_scoring import Score
from hilserver.diagnosis.checks import check
from hilserver.diagnosis.progress import Tracker
from hilserver.diagnosis.regression.gain import HORIZON_S, gains
from hilserver.diagnosis.regression.stages import Prepared, prepare_all
from hilserver.measured.data import MeasuredLog
from hilserver.measured.machine import machine
from hilserver.plant.parameters import RobotParameters


def require() -> None:
    """Check that every library is there that a rival needs.

    Raises
    ------
    FailedError
        If one of them is not installed.
    """
    sysid.library()
    sindy.library()


def answers(case: Case, log: MeasuredLog, robot: RobotParameters) -> dict[str, Any]:
    """Return the answer of every rival that has one, as plain data by its name.

    Rivals on velocities only get logs without an effect, and single causes for which PySINDy has
    terms.
    """
    found: dict[str, Any] = {}
    if case.group == "single":
        values = sysid.fitted(case, log, robot)
        found["sysid"] = {name: asdict(value) for name, value in values.items()}
    if case.group == "null" or (case.group == "single" and case.name in sindy.CAUSES):
        own = machine(log, robot)
        prepared, _ = prepare_all(check(log, own).log, own, 1, Tracker())
        if "pose" in prepared and applies(prepared["pose"].problem):
            pose = prepared["pose"]
            found["pysindy"] = scored(case, sindy.said(pose)).as_json()
            found["gains"] = compared(pose)
    return found


def compared(pose: Prepared) -> dict[str, dict[str, float]]:
    """Return the held-out gain of every rival by quantity."""
    problem, before = pose.problem, pose.base.predicted
    rng, found = np.random.default_rng(0), {}
    for name, predict in RIVALS.items():
        made = gains(problem, before, predict(pose), HORIZON_S, rng)
        found[name] = {quantity: one.ratio for quantity, one in made.items()}
    return found


def scored(case: Case, groups: Sequence[Sequence[str]]) -> Score:
    """Compare groups of causes with the answer; one that holds the truth is right."""
    truth = frozenset().union(*case.answer.causes)
    wrong = ["|".join(sorted(group)) for group in groups if not truth & set(group)]
    if truth:
        outcome = "right" if len(wrong) < len(groups) else "missed"
    else:
        outcome = "false_alarm" if groups else "right"
    return Score(
        outcome, wrong=wrong, found=["|".join(sorted(group)) for group in groups]
    )
