"""Data checks: faults of the log itself, found without the model and taken out of the data.

One file per check. Each takes a log and gives back the corrected log and what it found; the order
matters, because units and signs can only be judged on samples that are real.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Final

from hilserver.diagnosis.checks import (
    clocks,
    copied,
    held,
    interpolated,
    orientation,
    repeated,
    units,
    wrapped,
)
from hilserver.diagnosis.data import MeasuredLog
from hilserver.diagnosis.findings import Finding
from hilserver.plant.parameters import RobotParameters

Check = Callable[[MeasuredLog, RobotParameters], tuple[MeasuredLog, list[Finding]]]

ORDER: Final[tuple[Check, ...]] = (
    copied.find,
    interpolated.find,
    held.find,
    repeated.find,
    wrapped.find,
    units.find,
    orientation.find,
    clocks.find,
)


@dataclass(frozen=True)
class Checked:
    """A log after the data checks.

    Attributes
    ----------
    log : MeasuredLog
        Without the faults that were found.
    findings : tuple of Finding
        Each with verdict ``data_fault``; `regressors` names the channels it is about.
    """

    log: MeasuredLog
    findings: tuple[Finding, ...]


def check(log: MeasuredLog, robot: RobotParameters) -> Checked:
    """Find the faults of the log and take them out.

    Parameters
    ----------
    robot : RobotParameters
        Dimensions and signs of the machine as configured.
    """
    findings: list[Finding] = []
    for find in ORDER:
        log, found = find(log, robot)
        findings += found
    return Checked(log, tuple(findings))
