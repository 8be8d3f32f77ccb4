"""Set-points above the configured top speed: the plant scales them down, the machine may not."""

from dataclasses import replace

import numpy as np

from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import NEGLIGIBLE
from hilserver.measured.channels import SETPOINTS
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Report set-points that the replay scales down; the log is left unchanged."""
    sent = {name: log[name].values for name in SETPOINTS if name in log}
    fastest = {
        name: float(np.abs(values).max(initial=0.0)) for name, values in sent.items()
    }
    slow = max(fastest.values(), default=0.0) <= (1.0 + NEGLIGIBLE) * robot.max_rpm
    if slow or not log.drive_is_known:
        return log, []
    name = max(fastest, key=lambda one: fastest[one])
    note = (
        f"{name} reaches {fastest[name]:.4g} rpm, but plant.max_rpm is {robot.max_rpm:.4g}: the"
        " replay scales such set-points down; if the robot does not, set plant.max_rpm in the"
        " configuration or the mapping"
    )
    return replace(log, notices=(*log.notices, note)), []
