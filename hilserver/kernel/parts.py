"""What runs in the slices: the robot's parts, and the inputs and outputs of a user's block.

The generated step calls these in the order of the configuration.
"""

import math
from typing import Any

from hilserver.compiled import inlined
from hilserver.image import leases, word
from hilserver.kernel.places import Places, p, q, u, x, y
from hilserver.plant.battery import battery_step
from hilserver.plant.imu import imu_step
from hilserver.plant.nav import nav_step
from hilserver.plant.robot import robot_step
from hilserver.plant.shield import shield_step
from hilserver.plant.tof import tof_step
from hilserver.signals import SOURCES
from hilserver.status import BAD_SENSOR_FAILURE, GOOD

SCENARIO = SOURCES.index("scenario")

# --- the robot ------------------------------------------------------------------------------------


@inlined
def robot(at: Places, values: Any, words: Any) -> None:
    """Run steps 1 to 11 of the tick: command, wheels, kinematics, pose."""
    robot_step(p(at, values), x(at, values), u(at, values), y(at, values), q(at, words))


@inlined
def imu(at: Places, values: Any, words: Any) -> None:
    """Show yaw rate, heading and acceleration."""
    imu_step(p(at, values), x(at, values), u(at, values), y(at, values), q(at, words))


@inlined
def battery(at: Places, values: Any, words: Any) -> None:
    """Subtract the charge used in this run from the battery and show its voltage."""
    battery_step(
        p(at, values), x(at, values), u(at, values), y(at, values), q(at, words)
    )


@inlined
def shield(at: Places, values: Any, words: Any) -> None:
    """Show the blinking lamps and the temperature."""
    shield_step(
        p(at, values), x(at, values), u(at, values), y(at, values), q(at, words)
    )


@inlined
def tof(at: Places, values: Any, words: Any) -> None:
    """Show the four distances to the walls."""
    tof_step(
        p(at, values),
        x(at, values),
        u(at, values),
        y(at, values),
        q(at, words),
        values[at.hall : at.hall_end],
    )


@inlined
def nav(at: Places, values: Any, words: Any) -> None:
    """Show the pose as the navigation tag measures it."""
    nav_step(p(at, values), x(at, values), u(at, values), y(at, values), q(at, words))


# --- a user's block -------------------------------------------------------------------------------


@inlined
def read_inputs(slots: Any, u: Any, values: Any, words: Any) -> None:
    """Copy the signals in `slots` to a block's inputs."""
    for i in range(slots.shape[0]):
        u[i] = values[words[word.FRAME_BASE] + slots[i]]


@inlined
def give_up(y: Any) -> None:
    """Invalidate the outputs of a block that raised."""
    for i in range(y.shape[0]):
        y[i] = math.nan


@inlined
def write_outputs(slots: Any, y: Any, values: Any, words: Any) -> None:
    """Copy a block's outputs to the signals in `slots`; one that is not finite is Bad."""
    for i in range(slots.shape[0]):
        values[words[word.FRAME_BASE] + slots[i]] = y[i]
        status = GOOD if math.isfinite(y[i]) else BAD_SENSOR_FAILURE
        words[words[word.STATUS_BASE] + slots[i]] = status


@inlined
def drive(
    slots: Any, outputs: Any, ranges: Any, y: Any, values: Any, words: Any
) -> None:
    """Let a block's outputs command the signals they are wired to, as the source `scenario`.

    NaN or a value outside the range is not commanded; the previous command stays.
    """
    if words[word.LEASES] == 0:
        return
    row = words[word.LEASES] + leases.VALUES + SCENARIO * leases.ROW
    for i in range(slots.shape[0]):
        value = y[outputs[i]]
        if ranges[i, 0] <= value <= ranges[i, 1]:
            values[row + slots[i]] = value
            words[word.COMMANDED] = 1
