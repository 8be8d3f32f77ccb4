"""From physical parameters to the array `p`: every constant of a tick is computed here, once."""

import math
from dataclasses import replace

from hilserver.plant.battery import DUTY_FULL_PCT, HIGHEST_V, LOWEST_V, open_circuit_voltage
from hilserver.plant.errors import PlantError
from hilserver.plant.friction import anisotropy
from hilserver.plant.layout import RING, Parameters, State
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.shield import AMBIENT_DEGC, WARMING_S
from hilserver.plant.terms import TERMS, complete
from hilserver.plant.units import RPM_PER_RAD_S

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


def pack(robot: RobotParameters) -> Parameters:
    """Return the parameters as the kernels read them.

    Raises
    ------
    PlantError
        When a term does not fit the robot (a delay longer than its ring, a control period below
        the plant slice, friction_anisotropy without a wheelbase).
    """
    p = Parameters.zeros()
    term = _Values(robot)
    p.dt = robot.period_s
    p.seed = robot.seed
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
        raise PlantError(
            f"plant.terms.{name}: {delay_s:g} s is longer than the {most} runs of "
            f"{period_s * 1e3:g} ms that are remembered, {most * period_s:g} s."
        )
    nearest = float(round(runs))
    return nearest if abs(runs - nearest) < 1e-9 * max(nearest, 1.0) else runs


def _pack_command(p: Parameters, robot: RobotParameters, term: _Values) -> None:
    p.max_rpm = robot.max_rpm
    p.rpm_per_m_s = RPM_PER_RAD_S / robot.wheel_radius_m
    p.rpm_per_rad_s = RPM_PER_RAD_S / (2.0 * robot.yaw_sign * robot.wheel_radius_m * robot.k_om)
    p.half_track = robot.track_m / 2.0
    p.exclusive = robot.exclusive_twist
    p.mecanum = robot.is_mecanum
    p.body_wheels = robot.body_wheels
    p.ramp_step = robot.period_s / max(robot.safe_ramp_s, robot.period_s)
    delay_s, rate = term("actuation_delay"), term.given("setpoint_rate_limit")
    runs = _delay_runs("actuation_delay", delay_s, robot.period_s, RING - 1)
    p.delay_ticks = math.ceil(runs)  # set-points hold between ticks: the one valid at t - tau
    p.rate_step = math.inf if rate is None else rate * robot.period_s
    p.command_terms = delay_s > 0.0 or rate is not None


def _pack_controller(p: Parameters, robot: RobotParameters, term: _Values) -> None:
    c = robot.controller
    period_s = term.given("control_period")
    if period_s is None:
        period_s = robot.period_s
    if period_s < robot.period_s * (1.0 - 1e-9):
        raise PlantError(
            f"plant.terms.control_period: {period_s:g} s is below the plant slice, "
            f"{robot.period_s:g} s."
        )
    inverse_tracking = math.sqrt(c.k_i if c.k_d == 0.0 else c.k_i / c.k_d)  # 1/T_t, unscaled
    keep, gain = robot.loop.derivative(period_s)
    quantum, filter_s = term("encoder_quantization"), term("encoder_filter")
    p.k_p = c.k_p * (1.0 + term("controller_gains.p"))
    p.k_i_step = period_s * (c.k_i * (1.0 + term("controller_gains.i")))
    p.anti_windup_step = min(period_s * inverse_tracking, 1.0)  # beyond, it would overshoot
    p.limit = c.limit_pct * (term("saturation_limit") / 100.0)
    p.control_ticks = period_s / robot.period_s
    p.derivative_keep, p.derivative_gain = keep, gain
    p.quantum = quantum
    p.encoder_gain[:] = 1.0
    p.encoder_gain[_wheel("encoder_scale", term)] += term("encoder_scale.a")
    p.encoder_share, p.encoder_keep = encoder_weights(robot.period_s, filter_s)
    slower = period_s != robot.period_s
    switched = slower or robot.body_wheels or any(map(term.on, _DRIVE_SWITCHES))
    p.drive_terms = c.k_d > 0.0 or switched


def _pack_process(p: Parameters, robot: RobotParameters, term: _Values) -> None:
    loop = robot.loop
    gain = loop.gain * (1.0 + term("process_gain"))
    t1_s = loop.t1_s * (1.0 + term("time_constant"))
    matrices = replace(loop, gain=gain, t1_s=t1_s).process(robot.period_s, term("viscous_load"))
    p.a00, p.a01, p.a10, p.a11, p.b0, p.b1 = matrices
    p.inverse_t2 = 1.0 / loop.t2_s
    p.gain, p.t1, p.t2 = gain, t1_s, loop.t2_s
    p.viscous = term("viscous_load")
    p.euler = loop.euler
    p.sag = term("battery_sag")
    p.dead_zone = term("dead_zone")
    p.coulomb = term("coulomb_friction")
    p.stribeck = term("stribeck_friction.f_s")
    p.stribeck_speed = term("stribeck_friction.n_s")
    p.backlash = term("backlash") / 2.0
    p.wheel_load[_wheel("wheel_load", term)] = term("wheel_load.f")


def _pack_kinematics(p: Parameters, robot: RobotParameters, term: _Values) -> None:
    radius = robot.wheel_radius_m * (1.0 + term("wheel_radius"))
    half_difference = term("wheel_radius_difference") / 2.0
    factor, shift_m = 1.0, 0.0
    if term.on("friction_anisotropy.ratio") or term.on("friction_anisotropy.offset"):
        factor, shift_m = _anisotropy(robot, term)
    p.radius_left = radius * (1.0 + half_difference)
    p.radius_right = radius * (1.0 - half_difference)
    p.yaw_gain = robot.yaw_sign * (robot.k_om * (1.0 + term("rotation_gain")) * factor)
    p.icr = robot.icr_offset_m + (term("icr_offset") + shift_m)


def _wheel(cause: str, term: _Values) -> int:
    """Return the wheel that a cause is about."""
    wheel = term(f"{cause}.wheel")
    if wheel != int(wheel):
        raise PlantError(
            f"plant.terms.{cause}.wheel: must be 0 fl, 1 rl, 2 fr or 3 rr, not {wheel:g}."
        )
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
        raise PlantError(
            "plant.terms.friction_anisotropy: needs plant.wheelbase_m; two wheels do not scrub."
        )
    if abs(offset_m) >= robot.wheelbase_m / 2.0:
        raise PlantError(
            f"plant.terms.friction_anisotropy.offset: {offset_m:g} m must be below half the "
            f"wheelbase, {robot.wheelbase_m / 2.0:g} m."
        )
    ratio = term("friction_anisotropy.ratio")
    return anisotropy(robot.wheelbase_m, robot.track_m, ratio, offset_m)


def _pack_motion_terms(p: Parameters, robot: RobotParameters, term: _Values) -> None:
    p.kinematic_terms = robot.is_mecanum or any(map(term.on, _KINEMATIC_SWITCHES))
    p.base_turn = robot.k_om * robot.wheel_radius_m
    p.gain_speed = term("rotation_gain_speed")
    p.gain_radius = term("rotation_gain_radius")
    p.traction = 1.0 - term("traction_slip")
    p.roller_keep = 1.0 - term("roller_slip")
    p.body_lag = term("body_lag")
    p.longitudinal_slip = term("longitudinal_slip")
    p.acceleration_slip = term("acceleration_slip")
    p.side_slip = term("side_slip")
    p.misalignment = term("wheel_misalignment")
    p.slope_x = term("floor_slope.x")
    p.slope_y = term("floor_slope.y")
    p.surface_gain = 1.0 + term("surface_change.k_om")
    p.surface_speed = 1.0 + term("surface_change.v")
    p.region_x_min = term("surface_change.x_min")
    p.region_x_max = term("surface_change.x_max")
    p.region_y_min = term("surface_change.y_min")
    p.region_y_max = term("surface_change.y_max")
    p.runout = term("wheel_runout.amplitude")
    p.runout_phase = term("wheel_runout.phase")


def _pack_body_sensors(p: Parameters, robot: RobotParameters, term: _Values) -> None:
    imu, battery, tof = robot.imu, robot.battery, robot.tof
    p.imu_enabled = imu.enabled
    p.imu_delay = _delay_runs("imu_latency", term("imu_latency"), imu.period_s, RING - 2)
    p.gyro_gain = 1.0 + term("gyro_scale")
    p.gyro_bias = term("gyro_bias")
    p.gyro_noise = imu.gyro_noise_rad_s
    p.accel_noise = imu.accel_noise_m_s2
    p.battery_enabled = battery.enabled
    p.charge_per_a = battery.period_s / (battery.capacity_ah * 3600.0)
    p.resistance = battery.resistance_ohm
    p.idle_current = battery.idle_current_a
    p.duty_current = battery.full_duty_current_a / DUTY_FULL_PCT
    p.charge_0 = battery.initial_charge
    p.shield_period = battery.period_s
    p.shield_keep = math.exp(-battery.period_s / WARMING_S)
    p.tof_enabled = tof.enabled
    p.tof_x, p.tof_y = tof.mount_x_m, tof.mount_y_m
    p.tof_sin = math.sin(tof.field_of_view_rad / 2.0)
    p.tof_cos = math.cos(tof.field_of_view_rad / 2.0)


def _pack_navigation(p: Parameters, robot: RobotParameters, term: _Values) -> None:
    nav = robot.nav
    every = 1.0 / (nav.rate_hz * nav.period_s)
    if nav.enabled and (round(every) < 1 or abs(every - round(every)) > 1e-6 * every):
        near = max(math.floor(every), 1)
        near_hz = [1.0 / (n * nav.period_s) for n in (near + 1, near)]
        raise PlantError(
            f"sensors.nav.rate_hz: {nav.rate_hz:g} Hz does not fit its slice of "
            f"{nav.period_s * 1e3:g} ms; the nearest are {near_hz[0]:g} and {near_hz[1]:g} Hz."
        )
    step_s = nav.period_s * max(round(every), 1)
    latency_s = nav.latency_s + term("nav_latency")
    yaw_latency_s = nav.yaw_latency_s + term("yaw_latency")
    p.nav_enabled = nav.enabled
    p.nav_every = max(round(every), 1)
    p.nav_delay = _delay_runs("nav_latency", latency_s, nav.period_s, RING - 2)
    p.nav_yaw_delay = _delay_runs("yaw_latency", yaw_latency_s, nav.period_s, RING - 2)
    p.lever_x = nav.lever_arm_x_m + term("nav_lever_arm.x")
    p.lever_y = nav.lever_arm_y_m + term("nav_lever_arm.y")
    p.nav_scale = 1.0 + term("nav_scale")
    p.nav_frame_yaw = term("nav_frame_yaw")
    p.nav_white, p.nav_ou = nav.white_noise_m, nav.correlated_noise_m
    p.nav_yaw_ou = nav.yaw_noise_rad
    p.nav_ou_keep = math.exp(-step_s / nav.correlation_s)
    p.nav_yaw_ou_keep = math.exp(-step_s / nav.yaw_correlation_s)
    p.nav_bias = term("nav_position_bias.amplitude")
    p.nav_bias_wave = 2.0 * math.pi / term("nav_position_bias.wavelength")
    p.outlier_share = term("nav_outliers.share")
    p.outlier_size = term("nav_outliers.size")
    p.distortion_1 = term("heading_distortion.a1")
    p.distortion_phase_1 = term("heading_distortion.phase1")
    p.distortion_2 = term("heading_distortion.a2")
    p.distortion_phase_2 = term("heading_distortion.phase2")


def initial_state(robot: RobotParameters) -> State:
    """Return the state at rest in the origin."""
    battery, x = robot.battery, State.zeros()
    charge = battery.initial_charge
    x.charge = charge
    x.temperature = AMBIENT_DEGC
    rest_v = open_circuit_voltage.py_func(charge)
    rest_v -= battery.resistance_ohm * battery.idle_current_a
    x.battery_v = min(max(rest_v, LOWEST_V), HIGHEST_V)
    return x
