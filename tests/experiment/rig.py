"""A recording of a robot that follows the kinematics exactly: at rest, then in a circle."""

import numpy as np

from hilserver.body.parameters import BodyParameters
from hilserver.measured.channels import GYRO, SPEEDS, TAG
from hilserver.plant.parameters import RobotParameters
from tests.diagnosis.checks.samples import log_of

ROBOT = RobotParameters()
BODY = BodyParameters(robot=ROBOT)
START = (1.0, 2.0, 0.5)
RATE_HZ, REST_S, LENGTH_S = 50.0, 2.0, 8.0
LEFT_RPM, RIGHT_RPM = 3.0, -45.0
RAD_S = np.pi / 30.0
AHEAD_M_S = 0.5 * ROBOT.wheel_radius_m * RAD_S * (LEFT_RPM - RIGHT_RPM)
TURN_RAD_S = -ROBOT.wheel_radius_m * ROBOT.k_om * RAD_S * (LEFT_RPM + RIGHT_RPM)


def circle():
    """Stamps and columns: wheels, tag and gyro."""
    t = np.arange(int(LENGTH_S * RATE_HZ)) / RATE_HZ
    drives = t >= REST_S
    since = np.maximum(t - REST_S, 0.0)
    yaw = START[2] + TURN_RAD_S * since
    ahead, aside = AHEAD_M_S / TURN_RAD_S, -ROBOT.icr_offset_m
    x = (
        START[0]
        + ahead * (np.sin(yaw) - np.sin(START[2]))
        + aside * (np.cos(yaw) - np.cos(START[2]))
    )
    y = (
        START[1]
        - ahead * (np.cos(yaw) - np.cos(START[2]))
        + aside * (np.sin(yaw) - np.sin(START[2]))
    )
    sides = (LEFT_RPM, LEFT_RPM, RIGHT_RPM, RIGHT_RPM)
    columns = {name: rpm * drives for name, rpm in zip(SPEEDS, sides, strict=True)}
    columns |= dict(zip(TAG, (x, y, np.angle(np.exp(1j * yaw))), strict=True))
    return t, columns | {GYRO: TURN_RAD_S * drives}


def recording(without=(), **changed):
    """The log of it."""
    t, columns = circle()
    kept = {name: values for name, values in columns.items() if name not in without}
    return log_of(t, kept | changed)
