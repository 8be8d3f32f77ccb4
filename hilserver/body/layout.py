"""Where the numbers of the mechatronic model lie: parameters `p`, state `b`, addresses `a`.

`b` holds all that its future depends on, MuJoCo's integration state at its end, so that a copy is a
snapshot. Wheels stand in the order fl, rl, fr, rr and turn forward with a positive speed here; the
signals mirror the right ones. Vectors are in the frame of the body, its origin the centre of mass.
"""

from typing import Final

# --- outputs: the signals mech.*, in the order of the table ---------------------------------------
M_POSITION: Final = 0  # x, y, z [m]
M_ANGLES: Final = 3  # roll, pitch, yaw [rad]
M_VELOCITY: Final = 6  # linear, lateral [m/s], angular [rad/s]
M_TOF: Final = 9  # fl, fr, rl, rr [m]
M_GYRO: Final = 13  # [rad/s]
M_ACCEL: Final = 16  # [m/s2]
M_SPEED: Final = 19  # 4 wheels [rpm]
M_NORMAL: Final = 23  # 4 wheels [N]
M_SLIP: Final = 27  # 4 wheels [m/s]
M_TORQUE: Final = 31  # 4 wheels [Nm]
M_GAP: Final = 35  # [m], [rad]
N_M: Final = 37

# --- state b --------------------------------------------------------------------------------------
B_SPEED: Final = 0  # 4 [rad/s]
B_ANGLE: Final = 4  # 4 [rad]
B_DUTY: Final = 8  # 4 [%], behind the fast lag of the drive
B_TORQUE: Final = 12  # 4 [Nm]
B_SLIP: Final = 16  # 4 [m/s], along the wheel
B_NORMAL: Final = 20  # 4 [N] of the last step
B_CONTACT: Final = 24  # 4 x 3 [m], where they act
B_UP: Final = 36  # 4 x 3, their directions
B_ACCEL: Final = 48  # 3 [m/s2], specific force
B_POSE_REQUEST: Final = 51
B_FAILED: Final = 52  # 1: MuJoCo warned or a number is not finite; it stands still
B_WAIT: Final = 53  # plant ticks until the wheels' speeds are handed over
B_ASKED: Final = 54  # 4 [rad/s] or [%]: what the last run was driven by
B_WARNINGS: Final = 58  # MuJoCo's counters, as bits: 0.0 is none
B_SENSORS: Final = 65  # MuJoCo's sensors of the last step
B_MUJOCO: Final = 92  # time, qpos (7), qvel (6), ... as mj_getState writes them
B_QPOS: Final = B_MUJOCO + 1
B_QVEL: Final = B_QPOS + 7

# --- addresses a (int64) --------------------------------------------------------------------------
A_STEP: Final = 0  # mj_step
A_SET_STATE: Final = 1  # mj_setState
A_GET_STATE: Final = 2  # mj_getState
A_MODEL: Final = 3
A_DATA: Final = 4
A_COPY: Final = 5  # memcpy
A_SENSORS: Final = 6
A_WARNINGS: Final = 7
A_SIGNATURE: Final = 8  # no address: which parts of the state mj_getState writes
A_PUSH: Final = 9  # no address: where in the state force and moment on the body lie
N_A: Final = 10

N_WARNINGS: Final = 7  # a pair of int32 each: what it was about, how often
S_CONTACT: Final = 0  # sensors: per wheel net force (3), where it acts (3), world frame
S_ACCEL: Final = 24
N_SENSORS: Final = 27

# --- parameters p ---------------------------------------------------------------------------------
(
    P_STEP,  # [s]
    P_STEPS,  # per slice
    P_TICKS,  # plant ticks per slice
    P_TORQUE,  # 1: driven by torque, 0: by speed
    P_RADIUS,
    P_INERTIA,  # of a wheel with its drive [kg m2]
    P_RATE,  # (1 - exp(-dt/T1))/dt: exact for a wheel that turns freely
    P_SPEED_PER_DUTY,  # without load [rad/s per %]
    P_DUTY_KEEP,  # exp(-dt/T2)
    P_GRIP,  # mu along
    P_RATIO,  # friction across by friction along
    P_V0,
    P_ROLLING,
    P_AIR,  # [N s2/m2]
    P_REST_HEIGHT,  # of the centre of mass [m]
) = range(15)
P_COS: Final = 15  # 4: direction in which a tyre grips, from the wheel's plane
P_SIN: Final = 19  # 4
N_P: Final = 23
