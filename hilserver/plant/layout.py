"""The layout of every number of the robot: parameters `p`, state `x`, inputs `u`, outputs `y`.

All arrays are float64, one-dimensional and contiguous; `q`, as long as `y`, holds the OPC UA status
code of each output (int64). The order of wheels is always fl, rl, fr, rr. Everything that the
future depends on is in `x`, including delay rings, filter and noise states, so a copy of `x` is a
complete snapshot and equal `p`, `x`, `u` give equal bits.
"""

from typing import Annotated, Final

import numpy as np
from numpy.typing import NDArray

from hilserver.compiled.records import Record

RING: Final = 1024  # how many samples back a delay can reach

Wheels = Annotated[NDArray[np.float64], 4]  # fl, rl, fr, rr
Corners = Annotated[NDArray[np.float64], 4]  # fl, fr, rl, rr: EduArt's order
Lamps = Annotated[NDArray[np.float64], (4, 3)]  # the corners' red, green, blue
Three = Annotated[NDArray[np.float64], 3]
Ring3 = Annotated[NDArray[np.float64], (RING, 3)]
Ring4 = Annotated[NDArray[np.float64], (RING, 4)]

LEFT_WHEELS: Final = ("fl", "rl")
RIGHT_WHEELS: Final = ("fr", "rr")
WHEELS: Final = LEFT_WHEELS + RIGHT_WHEELS
N_WHEELS: Final = 4
CORNERS: Final = ("fl", "fr", "rl", "rr")  # EduArt's order: of range finders and lamps
WHEEL_WORDS: Final = {
    "fl": "front left",
    "rl": "rear left",
    "fr": "front right",
    "rr": "rear right",
}


class Inputs(Record):
    """What a tick latches: the inputs in the order of the signal table, then hidden ones."""

    setpoint: Wheels  # [rpm]
    twist_linear: float  # [m/s]
    twist_angular: float  # [rad/s]
    twist_lateral: float  # [m/s], mecanum only
    duty: Wheels  # [%]
    mode: float  # MODE_*
    enable: float
    light_pattern: float
    light_colour: Three  # red, green, blue
    sequence: float
    command: float  # hidden: COMMAND_*
    pose_request: float  # hidden: a counter; when it changes, the pose is set
    pose: Three  # hidden: x [m], y [m], yaw [rad]
    own_gains: float  # hidden: 1 while the next two replace the controller's gains
    k_p: float  # [%/rpm]
    k_i: float  # [%/(rpm s)]


# how many inputs, from the first, are set-points
N_SETPOINTS: Final = Inputs.where("mode").start
N_COMMANDS: Final = Inputs.where("enable").stop
"""How many inputs, from the first, are commands: the set-points, mode and enable."""

# values of `Inputs.mode`
MODE_WHEELS: Final = 0
MODE_TWIST: Final = 1
MODE_DUTY: Final = 2

# values of `Inputs.command`
COMMAND_NORMAL: Final = 0
COMMAND_ZERO: Final = 1
COMMAND_SAFE: Final = 2  # ramp to zero


class Outputs(Record):
    """Outputs of a tick in the order of the signal table.

    `robot_step` writes those up to `angular`, and `demand`. New ones come last: in an FMU the place
    is the value reference, which its users have wired.
    """

    speed: Wheels  # [rpm], as the encoder shows it
    duty: Wheels  # [%]
    angle: Wheels  # [rad], not wrapped
    pose: Three  # x [m], y [m], yaw [rad]
    linear: float  # [m/s]
    lateral: float  # [m/s]
    angular: float  # [rad/s]
    gyro: float  # [rad/s]
    heading: float  # of the inertial unit [rad]
    accel_x: float  # [m/s2]
    accel_y: float
    battery: float  # [V]
    tof: Corners  # [m]
    nav: Three  # x [m], y [m], yaw [rad]
    current: float  # [A]
    temperature: float  # [degC]
    light_pattern: float
    lights: Lamps  # red, green, blue of each
    demand: Wheels  # [rpm]: what the loops follow in this tick


class Status(Outputs, word=np.int64):
    """The OPC UA status code of every output."""


class State(Record):
    """All that the future depends on; a copy is a snapshot."""

    motor: Wheels  # [rpm]: first state of the process
    speed: Wheels  # [rpm]: of the wheel, on the motor's side
    integral: Wheels  # [%]
    angle: Wheels  # [rad]
    pose: Three  # x [m], y [m], yaw [rad]
    setpoint: Wheels  # [rpm]: what the loop follows in this tick
    commanded: Wheels  # [rpm]: what was commanded, before delay and rate limit
    duty: Wheels  # [%]: held between control periods
    accel_x: float  # [m/s2]: of the centre of mass at t_k, body frame
    accel_y: float
    twist_reduced: float  # 1 while exclusive mode drops a part of the twist
    scaled: float  # 1 while max_rpm scales the wheels down
    last_command: float
    ramp_ticks: float
    ramp_start: Wheels  # [rpm]
    pose_request: float
    control_phase: float  # ticks until the controller runs again
    derivative: Wheels  # [%]
    last_error: Wheels  # [rpm]
    encoder: Wheels  # [rpm]: encoder filter without the share of the newest speed
    gap: Wheels  # [rad]: motor angle minus wheel angle inside the backlash
    battery_v: float
    charge: float  # 1 full, 0 empty
    setpoint_head: float  # row of the newest entry of the ring
    imu_head: float
    imu_count: float  # samples in the ring
    nav_head: float
    nav_count: float  # samples in the ring
    nav_wait: float  # runs until the next sample
    nav_samples: float
    nav_ou: Three  # x [m], y [m], yaw [rad]
    imu_runs: float
    nav_shown: Three  # the last sample, shown until the next
    direct: float  # 1 while duties are commanded
    duty_command: Wheels  # [%]
    temperature: float  # [degC]
    light_pattern: float
    light_time: float  # [s] since the pattern began
    own_gains: float  # these three as in `Inputs`
    k_p: float
    k_i: float
    body_v: float  # [m/s]: speed of the body while it lags behind the wheels
    body_om: float  # [rad/s]
    setpoint_ring: Ring4  # [rpm] of each wheel
    imu_ring: Ring4  # rate [rad/s], heading [rad], forward and left acceleration [m/s2]
    nav_ring: Ring3  # x [m], y [m], yaw [rad]


class Parameters(Record):
    """A robot as the kernels read it, computed once by `packing.pack`. Flags are 1 or 0."""

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
    # share of the lateral speed that is left after the rollers' slip
    roller_keep: float
    # flag: the mechatronic model turns the wheels, instead of the process
    body_wheels: float
    ramp_step: float  # share of the safe ramp per tick
    command_terms: float  # flag: delay or rate limit is on
    drive_terms: float  # flag: `drive_terms` instead of `drive_base`
    kinematic_terms: float  # flag: kinematics with terms instead of the base
    # drive terms
    delay_ticks: float
    rate_step: float  # [rpm] per tick, inf: none
    control_ticks: float  # control period in ticks
    derivative_keep: float  # D <- keep D + gain (e - e_last)
    derivative_gain: float  # [%/rpm]
    encoder_gain: Wheels
    # weight of the newest speed in the encoder filter's output; 1: no filter
    encoder_share: float
    encoder_keep: float  # weight of its last output
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
    traction: float  # speed of the body as share of the wheels'
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
    shield_keep: float  # share of its warming left after a run
    tof_enabled: float  # flag
    tof_x: float  # [m] in front of the centre
    tof_y: float  # [m] to its side
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
    distortion_1: float  # [rad], one period per turn
    distortion_phase_1: float  # [rad]
    distortion_2: float  # [rad], two periods per turn
    distortion_phase_2: float  # [rad]
    # initial values of the state that are not zero
    charge_0: float  # 1 full, 0 empty


INPUTS: Final = Inputs.layout
OUTPUTS: Final = Outputs.layout
STATUS: Final = Status.layout
STATE: Final = State.layout
PARAMETERS: Final = Parameters.layout
