"""Limited channels: readings that stand at one value while the robot goes beyond it."""

from dataclasses import replace
from typing import Final

import numpy as np

from hilserver.diagnosis.checks.frame import asked_turn
from hilserver.diagnosis.checks.support import data_fault
from hilserver.diagnosis.schema.findings import Finding, Parameter
from hilserver.diagnosis.thresholds import FEWEST_PIECES, LIMITED_BEYOND, NEARLY_ALL
from hilserver.measured.arrays import Array
from hilserver.measured.channels import DUTIES, GYRO
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

AT: Final = 1.0 - 1e-9
"""Share of a limit at which a reading stands: files round."""


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
        found = [_finding(log[GYRO].values, limit, text)]
    return replace(log, limits=limits), found


def _finding(values: Array, limit: float, text: str) -> Finding:
    """Return the finding with the limits that readings reached, each by itself."""
    finding = data_fault("limited_channel", [GYRO], limit, None, "rad/s", text)
    reached = {
        f"limited_channel.{end}": Parameter(value=side * limit, ci95=None, unit="rad/s")
        for end, side in (("low", -1.0), ("high", 1.0))
        if (side * values >= limit * AT).any()
    }
    return finding.model_copy(update={"parameters": {**finding.parameters, **reached}})


def _ends_at(values: Array, most: float) -> bool:
    return bool(np.isclose(np.abs(values).max(initial=0.0), most))


def _limit(values: Array, asked: Array | None) -> float | None:
    """Return the largest reading if the turn that was asked for goes on beyond it."""
    if asked is None or len(values) < FEWEST_PIECES:
        return None
    limit = float(np.abs(values).max())
    at = np.abs(values) >= limit * AT
    inside = np.abs(values) < NEARLY_ALL * limit
    power = float(asked[inside] @ asked[inside])
    if at.sum() < FEWEST_PIECES or power == 0.0:
        return None
    ratio = float(asked[inside] @ values[inside]) / power
    beyond = np.sign(values[at]) * ratio * asked[at] / limit - 1.0
    return limit if float(np.median(beyond)) > LIMITED_BEYOND else None
