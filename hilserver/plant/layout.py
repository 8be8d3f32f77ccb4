"""Where every number of the robot lies: parameters `p`, state `x`, inputs `u`, outputs `y`.

All arrays are float64, one-dimensional and contiguous; `q`, as long as `y`, holds the OPC UA status
code of each output (int64). Wheels always stand in the order fl, rl, fr, rr. Everything that the
future depends on lies in `x` (delay rings, filter and noise states too), so a copy of `x` is a
complete snapshot and equal `p`, `x`, `u` give equal bits.
"""

from typing import Final

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
(
    P_DT,  # plant slice [s]
    P_KP,
    P_KI_STEP,  # control period times K_I
    P_ANTI_WINDUP_STEP,  # control period divided by T_t
    P_LIMIT,  # [%]
    P_A00,  # process over one tick: motor, speed <- A (motor, speed) + B duty
    P_A01,
    P_A10,
    P_A11,
    P_B0,
    P_B1,
    P_INVERSE_T2,
    P_RADIUS_LEFT,
    P_RADIUS_RIGHT,
    P_YAW_GAIN,  # yaw_sign times K_om with its constant factors
    P_ICR,
    P_MAX_RPM,
    P_RPM_PER_M_S,  # inverse kinematics (5.25), nominal
    P_RPM_PER_RAD_S,
    P_HALF_TRACK,
    P_EXCLUSIVE,
    P_MECANUM,  # 1: rollers let the wheels drive sideways
    P_ROLLER_KEEP,  # share of the lateral speed that the rollers' slip leaves
    P_BODY_WHEELS,  # 1: the mechatronic model turns the wheels, not the process
    P_RAMP_STEP,  # share of the safe ramp per tick
    P_COMMAND_TERMS,  # 1: delay or rate limit is on
    P_DRIVE_TERMS,  # 1: drive_terms instead of drive_base
    P_KINEMATIC_TERMS,  # 1: kinematic terms instead of the base
    # drive terms
    P_DELAY_TICKS,
    P_RATE_STEP,  # [rpm] per tick, inf: none
    P_CONTROL_TICKS,  # control period in ticks
    P_DERIVATIVE_KEEP,  # D <- keep D + gain (e - e_last)
    P_DERIVATIVE_GAIN,
    P_ENCODER_GAIN,  # of fl, then rl, fr, rr
    P_ENCODER_GAIN_1,
    P_ENCODER_GAIN_2,
    P_ENCODER_GAIN_3,
    P_ENCODER_SHARE,  # of the newest speed in what the encoder filter shows; 1: no filter
    P_ENCODER_KEEP,  # of the last value shown
    P_QUANTUM,  # [rpm]
    P_DEAD_ZONE,
    P_COULOMB,
    P_STRIBECK,
    P_STRIBECK_SPEED,
    P_LOAD,
    P_LOAD_1,
    P_LOAD_2,
    P_LOAD_3,
    P_SAG,
    P_VISCOUS,
    P_GAIN,  # of the process, with its term
    P_T1,
    P_T2,
    P_EULER,
    P_BACKLASH,  # half of the play [rad]
    # kinematic terms
    P_GAIN_SPEED,
    P_GAIN_RADIUS,
    P_BASE_TURN,  # nominal r K_om: |om| of the base model per rad/s
    P_TRACTION,  # share of the wheels' speed that the body has
    P_BODY_LAG,  # [s]
    P_LONGITUDINAL_SLIP,
    P_ACCELERATION_SLIP,
    P_SIDE_SLIP,
    P_MISALIGNMENT,
    P_SLOPE_X,
    P_SLOPE_Y,
    P_SURFACE_GAIN,  # factors inside the region
    P_SURFACE_SPEED,
    P_REGION_X_MIN,
    P_REGION_X_MAX,
    P_REGION_Y_MIN,
    P_REGION_Y_MAX,
    P_RUNOUT,
    P_RUNOUT_PHASE,
    # sensors
    P_SEED,
    P_IMU_ENABLED,
    P_IMU_DELAY,  # [runs of its slice], may be fractional
    P_GYRO_GAIN,
    P_GYRO_BIAS,
    P_GYRO_NOISE,
    P_ACCEL_NOISE,
    P_BATTERY_ENABLED,
    P_CHARGE_PER_A,  # share of the capacity that 1 A takes per run
    P_RESISTANCE,
    P_IDLE_CURRENT,
    P_DUTY_CURRENT,  # [A/%] per wheel
    P_SHIELD_PERIOD,  # slice of the shield [s]
    P_SHIELD_KEEP,  # share of its warming that is left after a run
    P_TOF_ENABLED,
    P_TOF_X,
    P_TOF_Y,
    P_TOF_SIN,  # of half the field of view
    P_TOF_COS,
    P_NAV_ENABLED,
    P_NAV_EVERY,  # runs per sample
    P_NAV_DELAY,  # [runs], may be fractional
    P_NAV_YAW_DELAY,
    P_LEVER_X,
    P_LEVER_Y,
    P_NAV_SCALE,
    P_NAV_FRAME_YAW,
    P_NAV_WHITE,
    P_NAV_OU,
    P_NAV_OU_KEEP,
    P_NAV_YAW_OU,
    P_NAV_YAW_OU_KEEP,
    P_BIAS,
    P_BIAS_WAVE,  # 2 pi / wavelength [1/m]
    P_OUTLIER_SHARE,
    P_OUTLIER_SIZE,
    P_DISTORTION_1,
    P_DISTORTION_PHASE_1,
    P_DISTORTION_2,
    P_DISTORTION_PHASE_2,
    # initial values of the state that are not zero
    P_CHARGE_0,
    N_P,
) = range(116)  # one more than there are parameters
P_WHEEL_LOAD: Final = P_LOAD  # 4 [%], contiguous
