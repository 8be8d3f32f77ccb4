"""Packs physical parameters into the array `p`: every constant of a tick is computed once."""

from hilserver.plant.battery import HIGHEST_V, LOWEST_V, open_circuit_voltage
from hilserver.plant.constants import compute
from hilserver.plant.errors import PlantError
from hilserver.plant.layout import RING, Parameters, State
from hilserver.plant.parameters import RobotParameters
from hilserver.plant.physical import (
    ACTUATION,
    ENCODER_WHEEL,
    FITS,
    IMU_DELAY,
    LOAD_WHEEL,
    NAV_DELAY,
    NAV_RATE,
    REASONS,
    SHORT_CONTROL,
    YAW_DELAY,
    physical,
)
from hilserver.plant.shield import AMBIENT_DEGC
from hilserver.plant.terms import complete


def pack(robot: RobotParameters) -> Parameters:
    """Return the parameters as the kernels read them.

    PlantError if a term does not fit the robot (a delay longer than its ring, a control period
    below the plant slice, friction_anisotropy without a wheelbase).
    """
    p = Parameters.zeros()
    code = compute(physical(robot), p)
    if code != FITS:
        raise PlantError(_sentence(code, robot))
    return p


def _sentence(code: int, robot: RobotParameters) -> str:
    """Return why a robot cannot be packed."""
    terms = {name: value or 0.0 for name, value in complete(robot.terms).items()}
    imu, nav = robot.imu, robot.nav
    latency_s = nav.latency_s + terms["nav_latency"]
    yaw_latency_s = nav.yaw_latency_s + terms["yaw_latency"]
    delays = {
        ACTUATION: (
            "actuation_delay",
            terms["actuation_delay"],
            robot.period_s,
            RING - 1,
        ),
        IMU_DELAY: ("imu_latency", terms["imu_latency"], imu.period_s, RING - 2),
        NAV_DELAY: ("nav_latency", latency_s, nav.period_s, RING - 2),
        YAW_DELAY: ("yaw_latency", yaw_latency_s, nav.period_s, RING - 2),
    }
    if code in delays:
        name, delay_s, period_s, most = delays[code]
        return (
            f"plant.terms.{name}: {delay_s:g} s is longer than the {most} runs of "
            f"{period_s * 1e3:g} ms that are remembered, {most * period_s:g} s."
        )
    if code in (ENCODER_WHEEL, LOAD_WHEEL):
        name = "encoder_scale.wheel" if code == ENCODER_WHEEL else "wheel_load.wheel"
        return f"plant.terms.{name}: must be 0 fl, 1 rl, 2 fr or 3 rr, not {terms[name]:g}."
    if code == SHORT_CONTROL:
        return (
            f"plant.terms.control_period: {terms['control_period']:g} s is below the plant slice, "
            f"{robot.period_s:g} s."
        )
    if code == NAV_RATE:
        near = max(int(1.0 / (nav.rate_hz * nav.period_s)), 1)
        near_hz = [1.0 / (n * nav.period_s) for n in (near + 1, near)]
        return (
            f"sensors.nav.rate_hz: {nav.rate_hz:g} Hz does not fit its slice of "
            f"{nav.period_s * 1e3:g} ms; the nearest are {near_hz[0]:g} and {near_hz[1]:g} Hz."
        )
    return f"plant: {REASONS[code]}."


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
