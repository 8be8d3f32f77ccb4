"""Duties that stay below the limit of the drive: either the drive or the log is limited.

In both cases readings pile up at one value. Only a limited drive makes its wheels slower.
"""

from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.limited import limited, piled_up
from hilserver.diagnosis.checks.support import listed
from hilserver.diagnosis.decide.identifiability import deviations
from hilserver.diagnosis.regression.problem import Problem
from hilserver.diagnosis.replay.drive_stage import FULL_DUTY_PCT, DriveStage
from hilserver.diagnosis.replay.stage import NO_POSES
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import (
    BLOCK_S,
    LEAST_GAIN,
    NEGLIGIBLE,
    RIVAL_CLEAR_Z,
)
from hilserver.measured.channels import DUTIES, SPEEDS
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

LIMIT: Final = "saturation_limit"


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find limits of logged duties and set them in the log: readings at a limit measure nothing."""
    most = robot.controller.limit_pct
    ends = {
        name: end
        for name in DUTIES
        if name in log
        and (end := piled_up(log[name].values)) is not None
        and end < (1.0 - NEGLIGIBLE) * most
    }
    if not ends or not DriveStage.judges(log) or not log.drive_is_known:
        return log, []
    problem = Problem(DriveStage(log, robot, block_s=BLOCK_S))
    free = problem.predict({}, NO_POSES)
    found = []
    for end in dict.fromkeys(ends.values()):
        names = [
            n
            for n, e in ends.items()
            if e == end and _goes_beyond(problem, free, n, end)
        ]
        if not names or not _free_to_turn(problem, free, FULL_DUTY_PCT * end / most):
            continue
        text = (
            f"{listed(names)}: no reading exceeds {end:.4g} % although the wheels turn as with"
            " more duty: the log is limited, not the drive; choose a larger range."
        )
        values = np.concatenate([log[name].values for name in names])
        found.append(limited(names, values, end, "%", text))
        log = log.with_limits(dict.fromkeys(names, end))
    return log, found


def _goes_beyond(problem: Problem, free: Array, name: str, end: float) -> bool:
    """Return whether the configured drive asks for more while a channel is at its limit."""
    edge = problem.stack.edges[name]
    at = np.abs(problem.stack.values[edge]) >= end
    return bool(
        at.any() and np.median(np.abs(free[edge][at])) > (1.0 + NEGLIGIBLE) * end
    )


def _free_to_turn(problem: Problem, free: Array, limit_pct: float) -> bool:
    """Return whether the wheel speeds contradict a limited drive."""
    stack = problem.stack
    left = [
        problem.residual(p)
        for p in (free, problem.predict({LIMIT: limit_pct}, NO_POSES))
    ]
    problem.estimate_noise(left[0])
    of_speeds = np.zeros(len(stack))
    for name in (n for n in SPEEDS if n in stack.edges):
        of_speeds[stack.edges[name]] = 1.0
    as_logged, as_limited = (problem.whiten(one) * of_speeds for one in left)
    worse = stack.block_sums(as_limited**2 - as_logged**2)
    return bool(worse.sum() > LEAST_GAIN and deviations(worse) > RIVAL_CLEAR_Z)
