"""Limited channels: readings that stand at one value while the robot goes beyond it."""

from dataclasses import replace

import numpy as np

from hilserver.diagnosis.checks.frame import asked_turn
from hilserver.diagnosis.checks.support import data_fault
from hilserver.diagnosis.schema.findings import Finding
from hilserver.diagnosis.thresholds import LIMITED_BEYOND, LIMITED_FEWEST, LIMITED_INSIDE
from hilserver.measured.channels import DUTIES, GYRO
from hilserver.measured.data import Array, MeasuredLog
from hilserver.plant.parameters import RobotParameters


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find limits of sensors; the log keeps them, for readings there are no measurements.

    A duty that ends where the plant's own does is no fault.
    """
    most = robot.controller.limit_pct
    limits = {name: most for name in DUTIES if name in log and _ends_at(log[name].values, most)}
    found = []
    if GYRO in log and (limit := _limit(log[GYRO].values, asked_turn(log, robot))) is not None:
        limits[GYRO] = limit
        text = (
            f"{GYRO}: no reading lies beyond {limit:.4g} rad/s although the robot turned faster:"
            " the sensor or its driver is limited; choose a larger range."
        )
        found = [data_fault("limited_channel", [GYRO], limit, None, "rad/s", text)]
    return replace(log, limits=limits), found


def _ends_at(values: Array, most: float) -> bool:
    return bool(np.isclose(np.abs(values).max(initial=0.0), most))


def _limit(values: Array, asked: Array | None) -> float | None:
    """Return the largest reading if the turn that was asked for goes on beyond it."""
    if asked is None or len(values) < LIMITED_FEWEST:
        return None
    limit = float(np.abs(values).max())
    at = np.abs(values) >= limit * (1.0 - 1e-9)
    inside = np.abs(values) < LIMITED_INSIDE * limit
    power = float(asked[inside] @ asked[inside])
    if at.sum() < LIMITED_FEWEST or power == 0.0:
        return None
    ratio = float(asked[inside] @ values[inside]) / power
    beyond = np.sign(values[at]) * ratio * asked[at] / limit - 1.0
    return limit if float(np.median(beyond)) > LIMITED_BEYOND else None
