"""Wheel speeds of a log that are not those of the wheels."""

from collections.abc import Mapping

from hilserver.diagnosis.catalogue.vocabulary import SPEED_SCALES
from hilserver.diagnosis.replay.model import robot_with
from hilserver.measured.data import MeasuredLog
from hilserver.plant.layout import P_ENCODER_GAIN
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters


def speed_factors(robot: RobotParameters, terms: Mapping[str, float]) -> dict[str, float]:
    """Return by how much each wheel's speed in the log is that of the wheel, where it is not 1."""
    gains = pack(robot_with(robot, {k: v for k, v in terms.items() if k.startswith("encoder")}))
    factors = {
        name: terms.get(scale, 1.0) * float(gains[P_ENCODER_GAIN + wheel])
        for wheel, (name, scale) in enumerate(SPEED_SCALES.items())
    }
    return {name: factor for name, factor in factors.items() if factor != 1.0}


def as_turned(log: MeasuredLog, robot: RobotParameters, terms: Mapping[str, float]) -> MeasuredLog:
    """Return the log with the speeds at which the wheels turned, whatever their encoders show."""
    factors = speed_factors(robot, terms)
    return log.with_channels({
        name: log[name].with_values(log[name].values / factor)
        for name, factor in factors.items() if name in log
    })  # fmt: skip
