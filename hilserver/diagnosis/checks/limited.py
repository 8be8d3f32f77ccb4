"""Limited channels: readings that stay at one value while the robot goes beyond it."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.frame import asked_turn
from hilserver.diagnosis.checks.support import data_fault, slope_of
from hilserver.diagnosis.schema.findings import Finding, Parameter
from hilserver.diagnosis.thresholds import FEWEST_PIECES, LIMITED_BEYOND, NEARLY_ALL
from hilserver.measured.channels import DUTIES, GYRO
from hilserver.measured.data import MeasuredLog
from hilserver.plant.parameters import RobotParameters

AT: Final = 1.0 - 1e-9  # share of a limit from which a reading is at it: files round


def find(log: MeasuredLog, robot: RobotParameters) -> tuple[MeasuredLog, list[Finding]]:
    """Find limits of sensors and set them in the log: readings at a limit measure nothing.

    A duty that ends at the plant's own limit is no fault; for one that ends below it see
    `decide.limited_duty`.
    """
    most = robot.controller.limit_pct
    limits = {
        name: most
        for name in DUTIES
        if name in log and np.isclose(np.abs(log[name].values).max(initial=0.0), most)
    }
    found = []
    if (
        GYRO in log
        and (limit := _limit(log[GYRO].values, asked_turn(log, robot))) is not None
    ):
        limits[GYRO] = limit
        text = (
            f"{GYRO}: no reading exceeds {limit:.4g} rad/s although the robot turned faster: the"
            " sensor or its driver is limited; choose a larger range."
        )
        found = [limited([GYRO], log[GYRO].values, limit, "rad/s", text)]
    return log.with_limits(limits), found


def limited(
    channels: Sequence[str], values: Array, limit: float, unit: str, text: str
) -> Finding:
    """Return the finding with the limit that each channel's readings reached."""
    finding = data_fault("limited_channel", channels, limit, None, unit, text)
    reached = {
        f"limited_channel.{end}": Parameter(value=side * limit, ci95=None, unit=unit)
        for end, side in (("low", -1.0), ("high", 1.0))
        if (side * values >= limit * AT).any()
    }
    return finding.model_copy(update={"parameters": {**finding.parameters, **reached}})


def piled_up(values: Array) -> float | None:
    """Return the largest reading of either sign if it is more frequent than by chance; or None."""
    limit = float(np.abs(values).max(initial=0.0))
    at = np.count_nonzero(np.abs(values) >= limit * AT)
    return limit if limit > 0.0 and at >= FEWEST_PIECES else None


def _limit(values: Array, asked: Array | None) -> float | None:
    """Return the largest reading if the turn that was asked for exceeds it."""
    limit = piled_up(values)
    if asked is None or limit is None:
        return None
    at = np.abs(values) >= limit * AT
    inside = np.abs(values) < NEARLY_ALL * limit
    ratio = slope_of(values[inside], asked[inside])
    beyond = np.sign(values[at]) * ratio * asked[at] / limit - 1.0
    return limit if float(np.median(beyond)) > LIMITED_BEYOND else None
