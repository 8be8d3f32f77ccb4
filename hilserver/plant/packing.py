"""From physical parameters to the array `p`: every constant of a tick is computed here, once."""

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

import hilserver.plant.layout as at
from hilserver.plant.battery import DUTY_FULL_PCT, HIGHEST_V, LOWEST_V, open_circuit_voltage
from hilserver.plant.errors import PlantError
from hilserver.plant.friction import anisotropy
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.shield import AMBIENT_DEGC, WARMING_S
from hilserver.plant.terms import TERMS, complete
from hilserver.plant.units import RPM_PER_RAD_S

Array = NDArray[np.float64]

_DRIVE_SWITCHES = (
    "coulomb_friction",
    "dead_zone",
    "stribeck_friction.f_s",
    "wheel_load.f",
    "battery_sag",
    "encoder_scale.a",
    "encoder_filter",
    "encoder_quantization",
    "backlash",
)
_KINEMATIC_SWITCHES = (
    "rotation_gain_speed",
    "rotation_gain_radius",
    "traction_slip",
    "body_lag",
    "longitudinal_slip",
    "acceleration_slip",
    "side_slip",
    "wheel_misalignment",
    "floor_slope.x",
    "floor_slope.y",
    "surface_change.k_om",
    "surface_change.v",
    "wheel_runout.amplitude",
)


class _Values:
    """The terms of one robot, asked by name."""

    def __init__(self, robot: RobotParameters) -> None:
        self._values = complete(robot.terms)

    def __call__(self, name: str) -> float:
        value = self._values[name]
        return 0.0 if value is None else value

    def given(self, name: str) -> float | None:
        return self._values[name]

    def on(self, name: str) -> bool:
        return self._values[name] != TERMS[name].null


def pack(robot: RobotParameters) -> Array:
    """Return the parameters as the kernels read them, shape (N_P,).

    Raises
    ------
    PlantError
        When a term does not fit the robot (a delay longer than its ring, a control period below
        the plant slice, friction_anisotropy without a wheelbase).
    """
    p = np.zeros(at.N_P)
    term = _Values(robot)
    p[at.P_DT] = robot.period_s
    p[at.P_SEED] = robot.seed
    _pack_command(p, robot, term)
    _pack_controller(p, robot, term)
    _pack_process(p, robot, term)
    _pack_kinematics(p, robot, term)
    _pack_motion_terms(p, robot, term)
    _pack_body_sensors(p, robot, term)
    _pack_navigation(p, robot, term)
    return p


def _delay_runs(name: str, delay_s: float, period_s: float, most: int) -> float:
    """Return a delay in runs of its slice; refuse what the ring cannot hold."""
    runs = delay_s / period_s
    if runs > most:
        msg = (
            f"plant.terms.{name}: {delay_s:g} s is longer than the {most} runs of "
            f"{period_s * 1e3:g} ms that are remembered, {most * period_s:g} s."
        )
        raise PlantError(msg)
    nearest = float(round(runs))
    return nearest if abs(runs - nearest) < 1e-9 * max(nearest, 1.0) else runs


def _pack_command(p: Array, robot: RobotParameters, term: _Values) -> None:
    p[at.P_MAX_RPM] = robot.max_rpm
    p[at.P_RPM_PER_M_S] = RPM_PER_RAD_S / robot.wheel_radius_m
    p[at.P_RPM_PER_RAD_S] = RPM_PER_RAD_S / (
        2.0 * robot.yaw_sign * robot.wheel_radius_m * robot.k_om
    )
    p[at.P_HALF_TRACK] = robot.track_m / 2.0
    p[at.P_EXCLUSIVE] = robot.exclusive_twist
    p[at.P_MECANUM] = robot.is_mecanum
    p[at.P_BODY_WHEELS] = robot.body_wheels
    p[at.P_RAMP_STEP] = robot.period_s / max(robot.safe_ramp_s, robot.period_s)
    delay_s, rate = term("actuation_delay"), term.given("setpoint_rate_limit")
    runs = _delay_runs("actuation_delay", delay_s, robot.period_s, at.RING - 1)
    p[at.P_DELAY_TICKS] = math.ceil(runs)  # set-points hold between ticks: the one valid at t - tau
    p[at.P_RATE_STEP] = math.inf if rate is None else rate * robot.period_s
    p[at.P_COMMAND_TERMS] = delay_s > 0.0 or rate is not None


def _pack_controller(p: Array, robot: RobotParameters, term: _Values) -> None:
    c = robot.controller
    period_s = term.given("control_period")
    if period_s is None:
        period_s = robot.period_s
    if period_s < robot.period_s * (1.0 - 1e-9):
        msg = (
            f"plant.terms.control_period: {period_s:g} s is below the plant slice, "
            f"{robot.period_s:g} s."
        )
        raise PlantError(msg)
    inverse_tracking = math.sqrt(c.k_i if c.k_d == 0.0 else c.k_i / c.k_d)  # 1/T_t, unscaled
    keep, gain = robot.loop.derivative(period_s)
    quantum, filter_s = term("encoder_quantization"), term("encoder_filter")
    p[at.P_KP] = c.k_p * (1.0 + term("controller_gains.p"))
    p[at.P_KI_STEP] = period_s * (c.k_i * (1.0 + term("controller_gains.i")))
    p[at.P_ANTI_WINDUP_STEP] = period_s * inverse_tracking
    p[at.P_LIMIT] = c.limit_pct * (term("saturation_limit") / 100.0)
    p[at.P_CONTROL_TICKS] = period_s / robot.period_s
    p[at.P_DERIVATIVE_KEEP], p[at.P_DERIVATIVE_GAIN] = keep, gain
    p[at.P_QUANTUM] = quantum
    p[at.P_ENCODER_GAIN : at.P_ENCODER_GAIN + at.N_WHEELS] = 1.0
    p[at.P_ENCODER_GAIN + _wheel("encoder_scale", term)] += term("encoder_scale.a")
    p[at.P_ENCODER_SHARE], p[at.P_ENCODER_KEEP] = encoder_weights(robot.period_s, filter_s)
    slower = period_s != robot.period_s
    switched = slower or robot.body_wheels or any(map(term.on, _DRIVE_SWITCHES))
    p[at.P_DRIVE_TERMS] = c.k_d > 0.0 or switched


def _pack_process(p: Array, robot: RobotParameters, term: _Values) -> None:
    loop = robot.loop
    gain = loop.gain * (1.0 + term("process_gain"))
    t1_s = loop.t1_s * (1.0 + term("time_constant"))
    matrices = replace(loop, gain=gain, t1_s=t1_s).process(robot.period_s, term("viscous_load"))
    p[at.P_A00 : at.P_B1 + 1] = matrices
    p[at.P_INVERSE_T2] = 1.0 / loop.t2_s
    p[at.P_GAIN], p[at.P_T1], p[at.P_T2] = gain, t1_s, loop.t2_s
    p[at.P_VISCOUS] = term("viscous_load")
    p[at.P_EULER] = loop.euler
    p[at.P_SAG] = term("battery_sag")
    p[at.P_DEAD_ZONE] = term("dead_zone")
    p[at.P_COULOMB] = term("coulomb_friction")
    p[at.P_STRIBECK] = term("stribeck_friction.f_s")
    p[at.P_STRIBECK_SPEED] = term("stribeck_friction.n_s")
    p[at.P_BACKLASH] = term("backlash") / 2.0
    p[at.P_LOAD + _wheel("wheel_load", term)] = term("wheel_load.f")


def _pack_kinematics(p: Array, robot: RobotParameters, term: _Values) -> None:
    radius = robot.wheel_radius_m * (1.0 + term("wheel_radius"))
    half_difference = term("wheel_radius_difference") / 2.0
    factor, shift_m = 1.0, 0.0
    if term.on("friction_anisotropy.ratio") or term.on("friction_anisotropy.offset"):
        factor, shift_m = _anisotropy(robot, term)
    p[at.P_RADIUS_LEFT] = radius * (1.0 + half_difference)
    p[at.P_RADIUS_RIGHT] = radius * (1.0 - half_difference)
    p[at.P_YAW_GAIN] = robot.yaw_sign * (robot.k_om * (1.0 + term("rotation_gain")) * factor)
    p[at.P_ICR] = robot.icr_offset_m + (term("icr_offset") + shift_m)


def _wheel(cause: str, term: _Values) -> int:
    """Return the wheel that a cause is about."""
    wheel = term(f"{cause}.wheel")
    if wheel != int(wheel):
        msg = f"plant.terms.{cause}.wheel: must be 0 fl, 1 rl, 2 fr or 3 rr, not {wheel:g}."
        raise PlantError(msg)
    return int(wheel)


def encoder_weights(period_s: float, filter_s: float) -> tuple[float, float]:
    """Return the weights of the newest speed and of the last value in an encoder's filter.

    First-order hold of a PT1 (Astrom and Wittenmark, Computer-Controlled Systems, 3rd ed., 8.3):
    the rest up to 1 goes to the speed of the tick before.
    """
    if filter_s <= 0.0:
        return 1.0, 0.0
    closed = -math.expm1(-period_s / filter_s)
    return max(1.0 - closed * filter_s / period_s, 0.0), 1.0 - closed


def _anisotropy(robot: RobotParameters, term: _Values) -> tuple[float, float]:
    offset_m = term("friction_anisotropy.offset")
    if robot.wheelbase_m is None:
        msg = "plant.terms.friction_anisotropy: needs plant.wheelbase_m; two wheels do not scrub."
        raise PlantError(msg)
    if abs(offset_m) >= robot.wheelbase_m / 2.0:
        msg = (
            f"plant.terms.friction_anisotropy.offset: {offset_m:g} m must be below half the "
            f"wheelbase, {robot.wheelbase_m / 2.0:g} m."
        )
        raise PlantError(msg)
    ratio = term("friction_anisotropy.ratio")
    return anisotropy(robot.wheelbase_m, robot.track_m, ratio, offset_m)


def _pack_motion_terms(p: Array, robot: RobotParameters, term: _Values) -> None:
    p[at.P_KINEMATIC_TERMS] = robot.is_mecanum or any(map(term.on, _KINEMATIC_SWITCHES))
    p[at.P_BASE_TURN] = robot.k_om * robot.wheel_radius_m
    p[at.P_GAIN_SPEED] = term("rotation_gain_speed")
    p[at.P_GAIN_RADIUS] = term("rotation_gain_radius")
    p[at.P_TRACTION] = 1.0 - term("traction_slip")
    p[at.P_ROLLER_KEEP] = 1.0 - term("roller_slip")
    p[at.P_BODY_LAG] = term("body_lag")
    p[at.P_LONGITUDINAL_SLIP] = term("longitudinal_slip")
    p[at.P_ACCELERATION_SLIP] = term("acceleration_slip")
    p[at.P_SIDE_SLIP] = term("side_slip")
    p[at.P_MISALIGNMENT] = term("wheel_misalignment")
    p[at.P_SLOPE_X] = term("floor_slope.x")
    p[at.P_SLOPE_Y] = term("floor_slope.y")
    p[at.P_SURFACE_GAIN] = 1.0 + term("surface_change.k_om")
    p[at.P_SURFACE_SPEED] = 1.0 + term("surface_change.v")
    p[at.P_REGION_X_MIN] = term("surface_change.x_min")
    p[at.P_REGION_X_MAX] = term("surface_change.x_max")
    p[at.P_REGION_Y_MIN] = term("surface_change.y_min")
    p[at.P_REGION_Y_MAX] = term("surface_change.y_max")
    p[at.P_RUNOUT] = term("wheel_runout.amplitude")
    p[at.P_RUNOUT_PHASE] = term("wheel_runout.phase")


def _pack_body_sensors(p: Array, robot: RobotParameters, term: _Values) -> None:
    imu, battery, tof = robot.imu, robot.battery, robot.tof
    p[at.P_IMU_ENABLED] = imu.enabled
    p[at.P_IMU_DELAY] = _delay_runs("imu_latency", term("imu_latency"), imu.period_s, at.RING - 2)
    p[at.P_GYRO_GAIN] = 1.0 + term("gyro_scale")
    p[at.P_GYRO_BIAS] = term("gyro_bias")
    p[at.P_GYRO_NOISE] = imu.gyro_noise_rad_s
    p[at.P_ACCEL_NOISE] = imu.accel_noise_m_s2
    p[at.P_BATTERY_ENABLED] = battery.enabled
    p[at.P_CHARGE_PER_A] = battery.period_s / (battery.capacity_ah * 3600.0)
    p[at.P_RESISTANCE] = battery.resistance_ohm
    p[at.P_IDLE_CURRENT] = battery.idle_current_a
    p[at.P_DUTY_CURRENT] = battery.full_duty_current_a / DUTY_FULL_PCT
    p[at.P_CHARGE_0] = battery.initial_charge
    p[at.P_SHIELD_PERIOD] = battery.period_s
    p[at.P_SHIELD_KEEP] = math.exp(-battery.period_s / WARMING_S)
    p[at.P_TOF_ENABLED] = tof.enabled
    p[at.P_TOF_X], p[at.P_TOF_Y] = tof.mount_x_m, tof.mount_y_m
    p[at.P_TOF_SIN] = math.sin(tof.field_of_view_rad / 2.0)
    p[at.P_TOF_COS] = math.cos(tof.field_of_view_rad / 2.0)


def _pack_navigation(p: Array, robot: RobotParameters, term: _Values) -> None:
    nav = robot.nav
    every = 1.0 / (nav.rate_hz * nav.period_s)
    if nav.enabled and (round(every) < 1 or abs(every - round(every)) > 1e-6 * every):
        near = max(math.floor(every), 1)
        near_hz = [1.0 / (n * nav.period_s) for n in (near + 1, near)]
        msg = (
            f"sensors.nav.rate_hz: {nav.rate_hz:g} Hz does not fit its slice of "
            f"{nav.period_s * 1e3:g} ms; the nearest are {near_hz[0]:g} and {near_hz[1]:g} Hz."
        )
        raise PlantError(msg)
    step_s = nav.period_s * max(round(every), 1)
    latency_s = nav.latency_s + term("nav_latency")
    yaw_latency_s = nav.yaw_latency_s + term("yaw_latency")
    p[at.P_NAV_ENABLED] = nav.enabled
    p[at.P_NAV_EVERY] = max(round(every), 1)
    p[at.P_NAV_DELAY] = _delay_runs("nav_latency", latency_s, nav.period_s, at.RING - 2)
    p[at.P_NAV_YAW_DELAY] = _delay_runs("yaw_latency", yaw_latency_s, nav.period_s, at.RING - 2)
    p[at.P_LEVER_X] = nav.lever_arm_x_m + term("nav_lever_arm.x")
    p[at.P_LEVER_Y] = nav.lever_arm_y_m + term("nav_lever_arm.y")
    p[at.P_NAV_SCALE] = 1.0 + term("nav_scale")
    p[at.P_NAV_FRAME_YAW] = term("nav_frame_yaw")
    p[at.P_NAV_WHITE], p[at.P_NAV_OU] = nav.white_noise_m, nav.correlated_noise_m
    p[at.P_NAV_YAW_OU] = nav.yaw_noise_rad
    p[at.P_NAV_OU_KEEP] = math.exp(-step_s / nav.correlation_s)
    p[at.P_NAV_YAW_OU_KEEP] = math.exp(-step_s / nav.yaw_correlation_s)
    p[at.P_BIAS] = term("nav_position_bias.amplitude")
    p[at.P_BIAS_WAVE] = 2.0 * math.pi / term("nav_position_bias.wavelength")
    p[at.P_OUTLIER_SHARE] = term("nav_outliers.share")
    p[at.P_OUTLIER_SIZE] = term("nav_outliers.size")
    p[at.P_DISTORTION_1] = term("heading_distortion.a1")
    p[at.P_DISTORTION_PHASE_1] = term("heading_distortion.phase1")
    p[at.P_DISTORTION_2] = term("heading_distortion.a2")
    p[at.P_DISTORTION_PHASE_2] = term("heading_distortion.phase2")


def initial_state(robot: RobotParameters) -> Array:
    """Return the state at rest in the origin, shape (N_X,)."""
    p = pack(robot)
    x = np.zeros(at.N_X)
    charge = float(p[at.P_CHARGE_0])
    x[at.X_CHARGE] = charge
    x[at.X_TEMPERATURE] = AMBIENT_DEGC
    rest_v = open_circuit_voltage.py_func(charge) - p[at.P_RESISTANCE] * p[at.P_IDLE_CURRENT]
    x[at.X_BATTERY_V] = min(max(rest_v, LOWEST_V), HIGHEST_V)
    return x
