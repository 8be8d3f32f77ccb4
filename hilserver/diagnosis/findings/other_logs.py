"""The gain on logs that took no part in selection or fit."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np

from hilserver.diagnosis.regression.gain import gains
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.regression.stages import stages_of
from hilserver.diagnosis.replay.model import Model
from hilserver.diagnosis.schema.findings import Gain
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

FEWEST_RUNS: Final = 4
LONGEST_RUN_S: Final = 300.0


def gain_on(
    log: MeasuredLog,
    robot: RobotParameters,
    models: Mapping[str, Model],
    horizon_s: float,
    rng: np.random.Generator,
    *,
    of_patch: bool = False,
) -> dict[str, Gain]:
    """Return what models of the stages gain on another log.

    If the log consists of several runs, free runs go from the beginning of each to its end;
    otherwise they last `horizon_s`.

    Parameters
    ----------
    of_patch : bool
        Also correct the log when replaying the configured plant: no patch does that.
    """
    lengths = [s.end_s - s.start_s for s in log.spans]
    if len(lengths) >= FEWEST_RUNS and max(lengths) <= LONGEST_RUN_S:
        horizon_s = math.inf
    found: dict[str, Gain] = {}
    known = models["drive"].terms if "drive" in models else {}
    for name, stage in stages_of(log, robot, drive_terms=known).items():
        problem, model = Problem(stage.uncut()), models.get(name, Model())
        base = model.without(*model.of_the_machine) if of_patch else Model()
        before, after = (
            problem.predict(m.terms, problem.start_poses(m.terms))
            for m in (base, model)
        )
        found |= gains(problem, before, after, horizon_s, rng)
    return found
