"""A machine whose kinematics no data identify: its wheels are in the air, or it never turned."""

from dataclasses import replace

import numpy as np

from hilserver.arrays import Array
from hilserver.diagnosis.checks.support import along, largest, slope_of
from hilserver.diagnosis.thresholds import SLOWEST_TURN_RAD_S, STANDS, TURNS_RAD_S
from hilserver.measured.channels import GYRO, POSITION, SPEEDS, YAW
from hilserver.measured.data import MeasuredLog
from hilserver.plant.packing import pack
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.units import RAD_S_PER_RPM


def unidentified(log: MeasuredLog, robot: RobotParameters) -> str | None:
    """Return why a log does not identify its machine's kinematics; None if it does.

    With wheels in the air they would all be completely wrong. Without a position, what the wheels
    ask of a machine that does not turn is their own noise.
    """
    turn = asked_turn(log, robot)
    if turn is None:
        return None
    if _turning(turn, TURNS_RAD_S):
        share = slope_of(log[GYRO].values, turn)
        return "did not turn although its wheels did" if abs(share) < STANDS else None
    if log.has(*POSITION) or _turning(turn, SLOWEST_TURN_RAD_S):
        return None
    return "hardly turned, and no position was measured"


def asked_turn(log: MeasuredLog, robot: RobotParameters) -> Array | None:
    """Return the turn rate [rad/s] that the wheels ask for at the gyro's samples."""
    if GYRO not in log or not log.has(*SPEEDS):
        return None
    start_s = np.array([span.start_s for span in log.spans])
    at = along(log[GYRO], start_s)
    left, right = (
        0.5
        * sum(
            np.interp(at, along(log[n], start_s), log[n].values) for n in SPEEDS[part]
        )
        for part in (slice(0, 2), slice(2, 4))
    )
    p = pack(robot)
    rims = p.radius_left * left + p.radius_right * right
    return np.asarray(p.yaw_gain * rims * RAD_S_PER_RPM)


def _turning(turn: Array, least_rad_s: float) -> bool:
    # wild wheel speeds are no turn
    sound = np.minimum(np.abs(turn), largest(turn))
    return float(sound @ sound) >= least_rad_s**2 * len(turn)


def without_kinematics(log: MeasuredLog, why: str) -> MeasuredLog:
    """Return a log without the channels that show the kinematics, see `unidentified`."""
    moved = {*POSITION, YAW, GYRO}
    kept = {name: c for name, c in log.channels.items() if name not in moved}
    note = f"the robot {why}: the kinematics are not judged"
    return replace(log, channels=kept, notices=(*log.notices, note))
