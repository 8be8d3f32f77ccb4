"""Where every number of the robot lies: parameters `p`, state `x`, inputs `u`, outputs `y`.

All arrays are float64, one-dimensional and contiguous; `q`, as long as `y`, holds the OPC UA status
code of each output (int64). Wheels always stand in the order fl, rl, fr, rr. Everything that the
future depends on lies in `x` (delay rings, filter and noise states too), so a copy of `x` is a
complete snapshot and equal `p`, `x`, `u` give equal bits.
"""

from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.records import Record

Wheels = Annotated[NDArray[np.float64], 4]
"""A number of each wheel."""

LEFT_WHEELS: Final = ("fl", "rl")
RIGHT_WHEELS: Final = ("fr", "rr")
WHEELS: Final = LEFT_WHEELS + RIGHT_WHEELS
N_WHEELS: Final = 4
WHEEL_WORDS: Final = {
    "fl": "front left",
    "rl": "rear left",
    "fr": "front right",
    "rr": "rear right",
}

# --- status codes (OPC UA part 4) -----------------------------------------------------------------
GOOD: Final = 0
UNCERTAIN: Final = 0x40000000
BAD_WAITING_FOR_INITIAL_DATA: Final = 0x80320000
BAD_OUT_OF_SERVICE: Final = 0x808D0000

# --- inputs u: the signal table's inputs, then three hidden ones ----------------------------------
U_SETPOINT: Final = 0  # 4 wheels [rpm]
U_TWIST_LINEAR: Final = 4  # [m/s]
U_TWIST_ANGULAR: Final = 5  # [rad/s]
U_TWIST_LATERAL: Final = 6  # [m/s], mecanum only
U_DUTY: Final = 7  # 4 wheels [%]
U_MODE: Final = 11  # MODE_*; what stands before it is a set-point
U_ENABLE: Final = 12
U_LIGHTS: Final = 13  # command, red, green, blue
U_SEQUENCE: Final = 17
U_COMMAND: Final = 18  # hidden: COMMAND_*
U_POSE_REQUEST: Final = 19  # hidden: a counter; when it changes, the pose is set
U_POSE: Final = 20  # hidden: x [m], y [m], yaw [rad]
U_GAINS: Final = 23  # hidden: 1 while the next two replace the controller's, K_P, K_I
N_U: Final = 26

# values of u[U_MODE]
MODE_WHEELS: Final = 0
MODE_TWIST: Final = 1
MODE_DUTY: Final = 2

# values of u[U_COMMAND]
COMMAND_NORMAL: Final = 0
COMMAND_ZERO: Final = 1
COMMAND_SAFE: Final = 2  # ramp to zero

# --- outputs y ------------------------------------------------------------------------------------
Y_SPEED: Final = 0  # 4 wheels [rpm], as the encoder shows it
Y_DUTY: Final = 4  # 4 wheels [%]
Y_ANGLE: Final = 8  # 4 wheels [rad], not wrapped
Y_POSE: Final = 12  # x [m], y [m], yaw [rad]
Y_VELOCITY: Final = 15  # linear [m/s], lateral [m/s], angular [rad/s]
N_Y_ROBOT: Final = 18  # robot_step writes y[:18], the sensors the rest
Y_IMU: Final = 18  # gyro_z [rad/s], yaw [rad], accel_x, accel_y [m/s2]
Y_BATTERY: Final = 22  # [V]
Y_TOF: Final = 23  # fl, fr, rl, rr [m]: EduArt's order
Y_NAV: Final = 27  # x [m], y [m], yaw [rad]
Y_CURRENT: Final = 30  # [A]
Y_TEMPERATURE: Final = 31  # [degC]
Y_LIGHTS: Final = 32  # pattern, then red, green, blue of fl, fr, rl, rr
N_Y: Final = 45

# --- state x --------------------------------------------------------------------------------------
RING: Final = 1024  # samples that a delay can reach back

X_MOTOR: Final = 0  # 4: first state of the process
X_SPEED: Final = 4  # 4: wheel (motor side) speed n [rpm]
X_INTEGRAL: Final = 8  # 4 [%]
X_ANGLE: Final = 12  # 4 [rad]
X_POSE: Final = 16  # 3
X_SETPOINT: Final = 19  # 4 [rpm]: what the loop follows in this tick
X_COMMANDED: Final = 23  # 4 [rpm]: what was commanded, before delay and rate limit
X_DUTY: Final = 27  # 4 [%]: held between control periods
X_ACCEL: Final = 31  # 2 [m/s2]: acceleration of the centre of mass at t_k, body frame
X_TWIST_REDUCED: Final = 33  # 1 while exclusive mode drops a part of the twist
X_SCALED: Final = 34  # 1 while max_rpm scales the wheels down
X_LAST_COMMAND: Final = 35
X_RAMP_TICKS: Final = 36
X_RAMP_START: Final = 37  # 4 [rpm]
X_POSE_REQUEST: Final = 41
X_CONTROL_PHASE: Final = 42  # ticks until the controller runs again
X_DERIVATIVE: Final = 43  # 4 [%]
X_LAST_ERROR: Final = 47  # 4 [rpm]
X_ENCODER: Final = 51  # 4 [rpm]: encoder filter, all but the share of the newest speed
X_GAP: Final = 55  # 4 [rad]: motor angle minus wheel angle inside the backlash
X_BATTERY_V: Final = 59
X_CHARGE: Final = 60  # 1 full, 0 empty
X_SETPOINT_HEAD: Final = 61  # newest entry of the set-point ring
X_IMU_HEAD: Final = 62
X_IMU_COUNT: Final = 63
X_NAV_HEAD: Final = 64
X_NAV_COUNT: Final = 65  # samples in the ring
X_NAV_WAIT: Final = 66  # runs until the next sample
X_NAV_SAMPLES: Final = 67
X_NAV_OU: Final = 68  # 3: x [m], y [m], yaw [rad]
X_IMU_RUNS: Final = 71
X_NAV_SHOWN: Final = 72  # 3: the last sample, shown until the next
X_DIRECT: Final = 75  # 1 while duties are commanded
X_DUTY_COMMAND: Final = 76  # 4 [%]
X_TEMPERATURE: Final = 80  # [degC]
X_LIGHT_PATTERN: Final = 81
X_LIGHT_TIME: Final = 82  # [s] since the pattern began
X_GAINS: Final = 83  # 3: as the input
X_BODY: Final = 86  # v [m/s], om [rad/s]: what the body has of them while it lags
X_SETPOINT_RING: Final = 88  # RING x 4
X_IMU_RING: Final = X_SETPOINT_RING + 4 * RING  # RING x 4
X_NAV_RING: Final = X_IMU_RING + 4 * RING  # RING x 3
N_X: Final = X_NAV_RING + 3 * RING

# --- parameters p ---------------------------------------------------------------------------------


class Parameters(Record):
    """What the kernels read of a robot: `packing.pack` computes it, once. Flags are 1 or 0."""

    dt: float  # plant slice [s]
    k_p: float  # [%/rpm]
    k_i_step: float  # control period times K_I [%/rpm]
    anti_windup_step: float  # control period divided by T_t
    limit: float  # of the duty [%]
    a00: float  # process over one tick: (motor, speed) <- A (motor, speed) + B duty
    a01: float
    a10: float
    a11: float
    b0: float  # [rpm/%]
    b1: float
    inverse_t2: float  # [1/s]
    radius_left: float  # [m]
    radius_right: float
    yaw_gain: float  # yaw_sign times K_om with its constant factors [1/m]
    icr: float  # X_ICR [m]
    max_rpm: float
    rpm_per_m_s: float  # inverse kinematics (5.25), nominal
    rpm_per_rad_s: float
    half_track: float  # [m]
    exclusive: float  # flag: v or om, never both
    mecanum: float  # flag: rollers let the wheels drive sideways
    roller_keep: float  # share of the lateral speed that the rollers' slip leaves
    body_wheels: float  # flag: the mechatronic model turns the wheels, not the process
    ramp_step: float  # share of the safe ramp per tick
    command_terms: float  # flag: delay or rate limit is on
    drive_terms: float  # flag: `drive_terms` instead of `drive_base`
    kinematic_terms: float  # flag: kinematic terms instead of the base
    # drive terms
    delay_ticks: float
    rate_step: float  # [rpm] per tick, inf: none
    control_ticks: float  # control period in ticks
    derivative_keep: float  # D <- keep D + gain (e - e_last)
    derivative_gain: float  # [%/rpm]
    encoder_gain: Wheels
    encoder_share: float  # of the newest speed in what the encoder filter shows; 1: no filter
    encoder_keep: float  # of the last value shown
    quantum: float  # [rpm]
    dead_zone: float  # [%]
    coulomb: float  # [%]
    stribeck: float  # [%]
    stribeck_speed: float  # [rpm]
    wheel_load: Wheels  # [%]
    sag: float  # of the gain, per relative voltage
    viscous: float  # [%/rpm]
    gain: float  # of the process, with its term [rpm/%]
    t1: float  # [s]
    t2: float  # [s]
    euler: float  # flag: forward differences
    backlash: float  # half of the play [rad]
    # kinematic terms
    gain_speed: float  # of K_om [s/m]
    gain_radius: float  # of K_om
    base_turn: float  # nominal r K_om: |om| of the base model per rad/s
    traction: float  # share of the wheels' speed that the body has
    body_lag: float  # [s]
    longitudinal_slip: float  # [s/rad]
    acceleration_slip: float  # [s2/m]
    side_slip: float  # [s]
    misalignment: float  # [rad]
    slope_x: float  # [m/s]
    slope_y: float  # [m/s]
    surface_gain: float  # factor on K_om inside the region
    surface_speed: float  # factor on v inside the region
    region_x_min: float  # [m]
    region_x_max: float
    region_y_min: float
    region_y_max: float
    runout: float  # share of the left radius
    runout_phase: float  # [rad]
    # sensors
    seed: float
    imu_enabled: float  # flag
    imu_delay: float  # [runs of its slice], may be fractional
    gyro_gain: float
    gyro_bias: float  # [rad/s]
    gyro_noise: float  # [rad/s]
    accel_noise: float  # [m/s2]
    battery_enabled: float  # flag
    charge_per_a: float  # share of the capacity that 1 A takes per run
    resistance: float  # [ohm]
    idle_current: float  # [A]
    duty_current: float  # [A/%] per wheel
    shield_period: float  # slice of the shield [s]
    shield_keep: float  # share of its warming that is left after a run
    tof_enabled: float  # flag
    tof_x: float  # [m] in front of the centre
    tof_y: float  # [m] beside it
    tof_sin: float  # of half the field of view
    tof_cos: float
    nav_enabled: float  # flag
    nav_every: float  # runs per sample
    nav_delay: float  # [runs], may be fractional
    nav_yaw_delay: float  # [runs]
    lever_x: float  # [m]
    lever_y: float
    nav_scale: float
    nav_frame_yaw: float  # [rad]
    nav_white: float  # [m]
    nav_ou: float  # [m]
    nav_ou_keep: float  # from one sample to the next
    nav_yaw_ou: float  # [rad]
    nav_yaw_ou_keep: float
    nav_bias: float  # [m]
    nav_bias_wave: float  # 2 pi / wavelength [1/m]
    outlier_share: float
    outlier_size: float  # [m]
    distortion_1: float  # [rad], of one period per turn
    distortion_phase_1: float  # [rad]
    distortion_2: float  # [rad], of two periods per turn
    distortion_phase_2: float  # [rad]
    # initial values of the state that are not zero
    charge_0: float  # 1 full, 0 empty


PARAMETERS: Final = Parameters.layout
