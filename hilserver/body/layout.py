"""The numbers of the mechatronic model by name: parameters `p`, state `b`, addresses `a`, outputs.

`b` holds all that the model's future depends on, at its end MuJoCo's integration state, so a copy
is a snapshot. The order of wheels is fl, rl, fr, rr; here all turn forward at a positive speed, the
signals mirror the right ones. Vectors are in the body's frame with the centre of mass as origin.
"""

from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.records import Record
from hilserver.plant.layout import Three, Wheels

N_WARNINGS: Final = 7

WheelVectors = Annotated[NDArray[np.float64], (4, 3)]


class Signals(Record):
    """The signals mech.*, in the order of the table."""

    position: Three  # [m]
    roll: float  # [rad]
    pitch: float
    yaw: float
    linear: float  # [m/s]
    lateral: float
    angular: float  # [rad/s]
    tof: Wheels  # fl, fr, rl, rr [m]
    gyro: Three  # [rad/s]
    accel: Three  # [m/s2]
    speed: Wheels  # [rpm]
    normal: Wheels  # [N]
    slip: Wheels  # [m/s]
    torque: Wheels  # [Nm]
    gap: float  # [m]
    gap_yaw: float  # [rad]
    bump: float


class BodyMotion(Record):
    """The state; MuJoCo's own begins at `time` and goes beyond this record."""

    speed: Wheels  # [rad/s]
    angle: Wheels  # [rad]
    duty: Wheels  # [%], behind the fast lag of the drive
    torque: Wheels  # [Nm]
    slip: Wheels  # [m/s], along the wheel
    normal: Wheels  # [N], in the last step
    contact: WheelVectors  # [m], where the normal forces act
    up: WheelVectors  # their directions
    accel: Three  # [m/s2], specific force
    bump: float  # 1: the bumper touched something in the last slice
    pose_request: float
    failed: float  # 1: MuJoCo warned or a number is not finite; the body stands still
    wait: float  # plant ticks until the wheels' speeds are passed to the plant
    asked: Wheels  # [rad/s] or [%]: input of the last run
    # MuJoCo's counters, as bits; 0.0: none
    warnings: Annotated[NDArray[np.float64], N_WARNINGS]
    # sensor: net force and where it acts, world
    touch: Annotated[NDArray[np.float64], (4, 2, 3)]
    bumps: float  # sensor: contacts of the bumper
    felt: Three  # sensor: specific force [m/s2]
    time: float  # from here as mj_getState writes it
    position: Three  # [m], world
    orientation: Wheels  # unit quaternion
    velocity: Three  # [m/s], world
    turning: Three  # [rad/s]


class Addresses(Record):
    """Addresses in this process: functions of C libraries, memory of MuJoCo."""

    step: int  # mj_step
    set_state: int  # mj_setState
    get_state: int  # mj_getState
    model: int
    memory: int  # of the model: mjData
    copy_bytes: int  # memcpy
    sensors: int
    warnings: int
    signature: int  # not an address: which parts of the state mj_getState writes
    push: int  # not an address: index in the state of force and moment on the body


class Constants(Record):
    """The body as the kernels read it."""

    dt: float  # of a step [s]
    steps: float  # per slice
    ticks: float  # plant ticks per slice
    torque: float  # 1: driven by torque, 0: by speed
    radius: float  # [m]
    inertia: float  # of a wheel with its drive [kg m2]
    rate: float  # (1 - exp(-dt/T1))/dt: exact for a wheel that turns freely
    speed_per_duty: float  # without load [rad/s per %]
    duty_keep: float  # exp(-dt/T2)
    grip: float  # mu along
    ratio: float  # friction across / along
    v0: float  # [m/s]
    rolling: float
    air: float  # [N s2/m2]
    rest_height: float  # of the centre of mass [m]
    cos: Wheels  # direction in which a tyre grips, from the wheel's plane
    sin: Wheels


class SignalStatus(Signals, word=np.int64):
    """The OPC UA status code of each."""


SIGNALS: Final = Signals.layout
STATUS: Final = SignalStatus.layout
MOTION: Final = BodyMotion.layout
ADDRESSES: Final = Addresses.layout
CONSTANTS: Final = Constants.layout
MUJOCO: Final = BodyMotion.where(
    "time"
).start  # where MuJoCo's part of the state begins
