"""The numbers of the mechatronic model by name: parameters `p`, state `b`, addresses `a`, outputs.

`b` holds all that its future depends on, MuJoCo's integration state at its end, so that a copy is a
snapshot. Wheels stand in the order fl, rl, fr, rr and turn forward with a positive speed here; the
signals mirror the right ones. Vectors are in the frame of the body, its origin the centre of mass.
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


class Motion(Record):
    """The state, up to where MuJoCo's own goes on."""

    speed: Wheels  # [rad/s]
    angle: Wheels  # [rad]
    duty: Wheels  # [%], behind the fast lag of the drive
    torque: Wheels  # [Nm]
    slip: Wheels  # [m/s], along the wheel
    normal: Wheels  # [N] of the last step
    contact: WheelVectors  # [m], where they act
    up: WheelVectors  # their directions
    accel: Three  # [m/s2], specific force
    bump: float  # 1: the bumper touched something in the last slice
    pose_request: float
    failed: float  # 1: MuJoCo warned or a number is not finite; it stands still
    wait: float  # plant ticks until the wheels' speeds are handed over
    asked: Wheels  # [rad/s] or [%]: what the last run was driven by
    warnings: Annotated[NDArray[np.float64], N_WARNINGS]  # MuJoCo's counters, as bits: 0.0 is none
    touch: Annotated[NDArray[np.float64], (4, 2, 3)]  # sensor: net force and where it acts, world
    bumps: float  # sensor: contacts of the bumper
    felt: Three  # sensor: specific force [m/s2]
    time: float  # from here on as mj_getState writes it
    position: Three  # [m], world
    orientation: Wheels  # unit quaternion
    velocity: Three  # [m/s], world
    turning: Three  # [rad/s]


class Addresses(Record):
    """Functions of C libraries and memory of MuJoCo, of this process."""

    step: int  # mj_step
    set_state: int  # mj_setState
    get_state: int  # mj_getState
    model: int
    memory: int  # of the model: mjData
    copy_bytes: int  # memcpy
    sensors: int
    warnings: int
    signature: int  # no address: which parts of the state mj_getState writes
    push: int  # no address: where in the state force and moment on the body lie


class Constants(Record):
    """What the kernels read of the body."""

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
    ratio: float  # friction across by friction along
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
MOTION: Final = Motion.layout
ADDRESSES: Final = Addresses.layout
CONSTANTS: Final = Constants.layout
MUJOCO: Final = Motion.where("time").start  # where in the state that of MuJoCo begins
