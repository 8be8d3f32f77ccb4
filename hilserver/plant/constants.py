"""Computes every constant of a tick from the physical parameters and checks that they fit together.

The same function serves the daemon, which runs it in Python once per change of parameters, and the
robot's FMU, which has it as C.
"""

import math
from typing import Any

from hilserver.compiled import plain
from hilserver.plant.battery import DUTY_FULL_PCT
from hilserver.plant.drive import process_matrices
from hilserver.plant.kinematics import nominal_gain
from hilserver.plant.layout import N_WHEELS, RING, Parameters
from hilserver.plant.physical import (
    ACTUATION,
    COARSE,
    ENCODER_WHEEL,
    FAR_CENTRE,
    FITS,
    IMU_DELAY,
    LOAD_WHEEL,
    NAV_DELAY,
    NAV_RATE,
    NO_FILTER,
    SHORT_CONTROL,
    UNSTABLE,
    YAW_DELAY,
    YAW_SIGN,
)
from hilserver.plant.shield import WARMING_S
from hilserver.plant.stability import derivative, euler_matrices, is_stable
from hilserver.plant.units import RPM_PER_RAD_S


@plain
def compute(v: Any, p: Parameters) -> int:
    """Compute all of `p`; return `FITS`, or the code of why the robot cannot run with it."""
    p.dt = v.period_s
    p.seed = v.seed
    code: int = _command(v, p)
    if code == FITS:
        code = _controller(v, p)
    if code == FITS:
        code = _process(v, p)
    if code == FITS:
        code = _kinematics(v, p)
    _motion_terms(v, p)
    if code == FITS:
        code = _body_sensors(v, p)
    if code == FITS:
        code = _navigation(v, p)
    return code


@plain
def _flag(on: bool) -> float:
    return 1.0 if on else 0.0


@plain
def delay_runs(delay_s: float, period_s: float) -> float:
    """Return a delay in runs of its slice, whole where it nearly is."""
    runs = delay_s / period_s
    nearest = float(math.floor(runs + 0.5))
    return nearest if abs(runs - nearest) < 1e-9 * max(nearest, 1.0) else runs


@plain
def _command(v: Any, p: Parameters) -> int:
    if abs(v.yaw_sign) != 1.0:
        return YAW_SIGN
    k_om = nominal_gain(
        v.rotation_gain, v.geometric_diff, v.mecanum, v.wheelbase_m, v.track_m
    )
    p.max_rpm = v.max_rpm
    p.rpm_per_m_s = RPM_PER_RAD_S / v.wheel_radius_m
    p.rpm_per_rad_s = RPM_PER_RAD_S / (2.0 * v.yaw_sign * v.wheel_radius_m * k_om)
    p.half_track = v.track_m / 2.0
    p.exclusive = v.exclusive
    p.mecanum = v.mecanum
    p.body_wheels = v.body_wheels
    p.ramp_step = v.period_s / max(v.safe_ramp_s, v.period_s)
    runs = delay_runs(v.term_actuation_delay, v.period_s)
    if runs > RING - 1:
        return ACTUATION
    # set-points hold between ticks: that of t - tau
    p.delay_ticks = float(math.ceil(runs))
    limited = not math.isnan(v.term_setpoint_rate_limit)
    p.rate_step = v.term_setpoint_rate_limit * v.period_s if limited else math.inf
    p.command_terms = _flag(v.term_actuation_delay > 0.0 or limited)
    return FITS


@plain
def _controller(v: Any, p: Parameters) -> int:
    period_s = v.term_control_period
    if math.isnan(period_s):
        period_s = v.period_s
    if period_s < v.period_s * (1.0 - 1e-9):
        return SHORT_CONTROL
    k_p, k_i, k_d = v.controller_k_p, v.controller_k_i, v.controller_k_d
    if k_d > 0.0 and k_p == 0.0:
        return NO_FILTER
    if v.term_encoder_scale_wheel != math.floor(v.term_encoder_scale_wheel):
        return ENCODER_WHEEL
    inverse_tracking = math.sqrt(k_i if k_d == 0.0 else k_i / k_d)  # 1/T_t, unscaled
    keep, gain = derivative(k_p, k_d, v.controller_derivative_n, period_s)
    p.k_p = k_p * (1.0 + v.term_controller_gains_p)
    p.k_i_step = period_s * (k_i * (1.0 + v.term_controller_gains_i))
    p.anti_windup_step = min(period_s * inverse_tracking, 1.0)  # more would overshoot
    p.limit = v.controller_limit_pct * (v.term_saturation_limit / 100.0)
    p.control_ticks = period_s / v.period_s
    p.derivative_keep, p.derivative_gain = keep, gain
    p.quantum = v.term_encoder_quantization
    for i in range(N_WHEELS):
        p.encoder_gain[i] = 1.0
    p.encoder_gain[int(v.term_encoder_scale_wheel)] += v.term_encoder_scale_a
    p.encoder_share, p.encoder_keep = encoder_weights(v.period_s, v.term_encoder_filter)
    slower = period_s != v.period_s
    switched = slower or v.body_wheels != 0.0 or _drive_switched(v)
    p.drive_terms = _flag(k_d > 0.0 or switched)
    return FITS


@plain
def _drive_switched(v: Any) -> bool:
    return bool(
        v.term_coulomb_friction != 0.0
        or v.term_dead_zone != 0.0
        or v.term_stribeck_friction_f_s != 0.0
        or v.term_wheel_load_f != 0.0
        or v.term_battery_sag != 0.0
        or v.term_encoder_scale_a != 0.0
        or v.term_encoder_filter != 0.0
        or v.term_encoder_quantization != 0.0
        or v.term_backlash != 0.0
    )


@plain
def encoder_weights(period_s: float, filter_s: float) -> tuple[float, float]:
    """Return the weights of the newest speed and of the last output in an encoder filter.

    First-order hold of a PT1 (Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., 8.3):
    the remainder up to 1 is the weight of the previous tick's speed.
    """
    if filter_s <= 0.0:
        return 1.0, 0.0
    closed = -math.expm1(-period_s / filter_s)
    return max(1.0 - closed * filter_s / period_s, 0.0), 1.0 - closed


@plain
def _process(v: Any, p: Parameters) -> int:
    dt_s, t2_s = v.period_s, v.process_t2_s
    gain = v.process_gain * (1.0 + v.term_process_gain)
    t1_s = v.process_t1_s * (1.0 + v.term_time_constant)
    if v.euler != 0.0:
        if dt_s >= 2.0 * t2_s:
            return COARSE
        matrices = euler_matrices(gain, v.term_viscous_load, t1_s, t2_s, dt_s)
    else:
        matrices = process_matrices(gain, v.term_viscous_load, t1_s, t2_s, dt_s)
    if not is_stable(
        v.process_gain,
        v.process_t1_s,
        t2_s,
        v.controller_k_p,
        v.controller_k_i,
        v.controller_k_d,
        v.controller_derivative_n,
        dt_s,
        v.euler != 0.0,
    ):
        return UNSTABLE
    if v.term_wheel_load_wheel != math.floor(v.term_wheel_load_wheel):
        return LOAD_WHEEL
    p.a00, p.a01, p.a10, p.a11, p.b0, p.b1 = matrices
    p.inverse_t2 = 1.0 / t2_s
    p.gain, p.t1, p.t2 = gain, t1_s, t2_s
    p.viscous = v.term_viscous_load
    p.euler = v.euler
    p.sag = v.term_battery_sag
    p.dead_zone = v.term_dead_zone
    p.coulomb = v.term_coulomb_friction
    p.stribeck = v.term_stribeck_friction_f_s
    p.stribeck_speed = v.term_stribeck_friction_n_s
    p.backlash = v.term_backlash / 2.0
    for i in range(N_WHEELS):
        p.wheel_load[i] = 0.0
    p.wheel_load[int(v.term_wheel_load_wheel)] = v.term_wheel_load_f
    return FITS


@plain
def _kinematics(v: Any, p: Parameters) -> int:
    if abs(v.icr_offset_m) >= v.wheelbase_m / 2.0:  # never true with two wheels: NaN
        return FAR_CENTRE
    k_om = nominal_gain(
        v.rotation_gain, v.geometric_diff, v.mecanum, v.wheelbase_m, v.track_m
    )
    radius = v.wheel_radius_m * (1.0 + v.term_wheel_radius)
    half_difference = v.term_wheel_radius_difference / 2.0
    p.radius_left = radius * (1.0 + half_difference)
    p.radius_right = radius * (1.0 - half_difference)
    p.yaw_gain = v.yaw_sign * (
        k_om * (1.0 + v.term_rotation_gain) * v.anisotropy_factor
    )
    p.icr = v.icr_offset_m + (v.term_icr_offset + v.anisotropy_shift_m)
    p.base_turn = k_om * v.wheel_radius_m
    return FITS


@plain
def _motion_terms(v: Any, p: Parameters) -> None:
    p.kinematic_terms = _flag(v.mecanum != 0.0 or _motion_switched(v))
    p.gain_speed = v.term_rotation_gain_speed
    p.gain_radius = v.term_rotation_gain_radius
    p.traction = 1.0 - v.term_traction_slip
    p.roller_keep = 1.0 - v.term_roller_slip
    p.body_lag = v.term_body_lag
    p.longitudinal_slip = v.term_longitudinal_slip
    p.acceleration_slip = v.term_acceleration_slip
    p.side_slip = v.term_side_slip
    p.misalignment = v.term_wheel_misalignment
    p.slope_x = v.term_floor_slope_x
    p.slope_y = v.term_floor_slope_y
    p.surface_gain = 1.0 + v.term_surface_change_k_om
    p.surface_speed = 1.0 + v.term_surface_change_v
    p.region_x_min = v.term_surface_change_x_min
    p.region_x_max = v.term_surface_change_x_max
    p.region_y_min = v.term_surface_change_y_min
    p.region_y_max = v.term_surface_change_y_max
    p.runout = v.term_wheel_runout_amplitude
    p.runout_phase = v.term_wheel_runout_phase


@plain
def _motion_switched(v: Any) -> bool:
    return bool(
        v.term_rotation_gain_speed != 0.0
        or v.term_rotation_gain_radius != 0.0
        or v.term_traction_slip != 0.0
        or v.term_body_lag != 0.0
        or v.term_longitudinal_slip != 0.0
        or v.term_acceleration_slip != 0.0
        or v.term_side_slip != 0.0
        or v.term_wheel_misalignment != 0.0
        or v.term_floor_slope_x != 0.0
        or v.term_floor_slope_y != 0.0
        or v.term_surface_change_k_om != 0.0
        or v.term_surface_change_v != 0.0
        or v.term_wheel_runout_amplitude != 0.0
    )


@plain
def _body_sensors(v: Any, p: Parameters) -> int:
    p.imu_enabled = v.imu_enabled
    p.imu_delay = delay_runs(v.term_imu_latency, v.imu_period_s)
    if p.imu_delay > RING - 2:
        return IMU_DELAY
    p.gyro_gain = 1.0 + v.term_gyro_scale
    p.gyro_bias = v.term_gyro_bias
    p.gyro_noise = v.imu_gyro_noise_rad_s
    p.accel_noise = v.imu_accel_noise_m_s2
    p.battery_enabled = v.battery_enabled
    p.charge_per_a = v.battery_period_s / (v.battery_capacity_ah * 3600.0)
    p.resistance = v.battery_resistance_ohm
    p.idle_current = v.battery_idle_current_a
    p.duty_current = v.battery_full_duty_current_a / DUTY_FULL_PCT
    p.charge_0 = v.battery_initial_charge
    p.shield_period = v.battery_period_s
    p.shield_keep = math.exp(-v.battery_period_s / WARMING_S)
    p.tof_enabled = v.tof_enabled
    p.tof_x, p.tof_y = v.tof_mount_x_m, v.tof_mount_y_m
    p.tof_sin = math.sin(v.tof_field_of_view_rad / 2.0)
    p.tof_cos = math.cos(v.tof_field_of_view_rad / 2.0)
    return FITS


@plain
def _navigation(v: Any, p: Parameters) -> int:
    every = 1.0 / (v.nav_rate_hz * v.nav_period_s)
    nearest = float(math.floor(every + 0.5))
    if v.nav_enabled != 0.0 and (nearest < 1.0 or abs(every - nearest) > 1e-6 * every):
        return NAV_RATE
    step_s = v.nav_period_s * max(nearest, 1.0)
    p.nav_enabled = v.nav_enabled
    p.nav_every = max(nearest, 1.0)
    p.nav_delay = delay_runs(v.nav_latency_s + v.term_nav_latency, v.nav_period_s)
    p.nav_yaw_delay = delay_runs(
        v.nav_yaw_latency_s + v.term_yaw_latency, v.nav_period_s
    )
    if p.nav_delay > RING - 2:
        return NAV_DELAY
    if p.nav_yaw_delay > RING - 2:
        return YAW_DELAY
    p.lever_x = v.nav_lever_arm_x_m + v.term_nav_lever_arm_x
    p.lever_y = v.nav_lever_arm_y_m + v.term_nav_lever_arm_y
    p.nav_scale = 1.0 + v.term_nav_scale
    p.nav_frame_yaw = v.term_nav_frame_yaw
    p.nav_white, p.nav_ou = v.nav_white_noise_m, v.nav_correlated_noise_m
    p.nav_yaw_ou = v.nav_yaw_noise_rad
    p.nav_ou_keep = math.exp(-step_s / v.nav_correlation_s)
    p.nav_yaw_ou_keep = math.exp(-step_s / v.nav_yaw_correlation_s)
    p.nav_bias = v.term_nav_position_bias_amplitude
    p.nav_bias_wave = 2.0 * math.pi / v.term_nav_position_bias_wavelength
    p.outlier_share = v.term_nav_outliers_share
    p.outlier_size = v.term_nav_outliers_size
    p.distortion_1 = v.term_heading_distortion_a1
    p.distortion_phase_1 = v.term_heading_distortion_phase1
    p.distortion_2 = v.term_heading_distortion_a2
    p.distortion_phase_2 = v.term_heading_distortion_phase2
    return FITS
