"""A robot that drives sideways: nobody judges this motion, and the reader hears so."""

from dataclasses import replace

from hilserver.diagnosis.schema.findings import Finding
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

NOTE = (
    "sideways motion (plant.drive: mecanum) is not judged: the replay drives forward and turns"
    " only, so use logs in which the robot did the same"
)


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Tell that sideways motion takes no part; the log is left as it is."""
    return (replace(log, notices=(*log.notices, NOTE)) if robot.is_mecanum else log), []
