"""Wheel speeds in a log that are not the true speeds of the wheels."""

from collections.abc import Mapping

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.catalogue.vocabulary import SPEED_SCALES
from hilserver.diagnosis.replay.drive_stage import DriveStage
from hilserver.diagnosis.replay.model import robot_with
from hilserver.measured.data import MeasuredLog
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters

Driven = tuple[DriveStage, Array, Array]
"""A drive; for its wheels at every tick the speed, and what correctly scaled encoders show."""


def driven(drive: DriveStage, terms: Mapping[str, float]) -> Driven:
    """Return how the wheels of a drive turn, and what encoders show of that."""
    speed, seen, _ = drive.simulate(terms)
    shown = seen / _gains(drive.robot, terms)
    return drive, speed, speed if np.array_equal(shown, speed) else shown


def _gains(robot: RobotParameters, terms: Mapping[str, float]) -> Array:
    p = pack(
        robot_with(robot, {k: v for k, v in terms.items() if k.startswith("encoder")})
    )
    return p.encoder_gain


def as_turned(
    log: MeasuredLog, robot: RobotParameters, terms: Mapping[str, float]
) -> MeasuredLog:
    """Return the log with the true speeds of the wheels, whatever their encoders show."""
    turned = {}
    for (name, scale), gain in zip(
        SPEED_SCALES.items(), _gains(robot, terms), strict=True
    ):
        factor = terms.get(scale, 1.0) * float(gain)
        if name in log and factor != 1.0:
            turned[name] = log[name].with_values(log[name].values / factor)
    return log.with_channels(turned)
